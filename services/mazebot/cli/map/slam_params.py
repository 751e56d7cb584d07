"""A file of mapping's parameters: their names and values, or a file of slam_toolbox."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from mazebot.common.config import ConfigError, must
from mazebot.common.files.yaml_source import read_source

if TYPE_CHECKING:
    from mazebot.mapping.params import SlamParams

_SECTIONS = ("slam_toolbox", "mapping")
_ROS = "ros__parameters"


def read_slam_params(path: Path) -> tuple[SlamParams, tuple[str, ...]]:
    """The parameters, and the names of those that a file of slam_toolbox has beside them.

    Raises ConfigError with one line that names file, line, field, value and what is right.
    """
    from mazebot.mapping.params import SlamParams  # noqa: PLC0415

    source = read_source(path, str(path))
    values: Any = source.content
    location: tuple[str, ...] = ()
    for key in (*(key for key in _SECTIONS if key in values), _ROS):
        if isinstance(values, Mapping) and key in values:
            values, location = values[key], (*location, key)
    where = f"{path}:{source.line_of(location) or 1}"
    if not isinstance(values, Mapping):
        raise ConfigError(f"{where}: {values!r:.60}: must be names of parameters and their values")
    known = {str(name): value for name, value in values.items() if name in SlamParams.model_fields}
    others = [str(name) for name in values if name not in SlamParams.model_fields]
    if others and _ROS not in location:
        name = others[0]
        near = get_close_matches(name, SlamParams.model_fields, 1) or list(SlamParams.model_fields)
        line = source.line_of((*location, name))
        raise ConfigError(f"{path}:{line}: {name}: no such parameter: must be {', '.join(near)}")
    try:
        return SlamParams(**known), tuple(others)
    except ValidationError as error:
        first = error.errors()[0]
        field = str(first["loc"][0])
        line = source.line_of((*location, field))
        raise ConfigError(
            f"{path}:{line}: {field}: {first['input']!r:.60}: {must(first['msg'])}"
        ) from error
