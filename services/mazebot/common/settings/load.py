"""The configuration of a service: flags over environment over YAML file over defaults."""

from __future__ import annotations

import functools
import logging
import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import ValidationError

from mazebot.common.config import (
    ConfigError,
    ServiceConfig,
    merged,
    one_line,
    setting_names,
    value_of,
)
from mazebot.common.files import bounded_yaml
from mazebot.common.files.limits import MAX_TEXT_BYTES
from mazebot.common.files.reading import NotReadableError, read_limited, reason
from mazebot.common.settings.known_settings import (
    PREFIX,
    matching,
    unknown_name,
    unknown_setting,
    unknown_variable,
    variable,
)

if TYPE_CHECKING:
    from mazebot.common.nav2_params.loader import Nav2Params

C = TypeVar("C", bound=ServiceConfig)

ROS_DOMAIN = "ROS_DOMAIN_ID"
"""The variable of ROS 2 that names the domain where no setting does."""

_NOTHING: Mapping[str, object] = {}


def load(
    model: type[C], service: str, arguments: Sequence[str], given: Mapping[str, object] = _NOTHING
) -> C:
    """Read a service's configuration.

    Flags (`--scan-rate-hz 5`) win over the environment (`MAZEBOT_PHYSICS_SCAN_RATE_HZ`), over the
    service's section of the YAML file that `--config` or `MAZEBOT_CONFIG` names, over Nav2's
    parameter file that `--params` or `MAZEBOT_PARAMS` names, over the defaults; and the values
    `given` by name win over all.

    Raises ConfigError with one line that names the source, the field and the value.
    """
    rest, path = _take_file_flag(arguments, "config")
    rest, params_path = _take_file_flag(rest, "params")
    fields = setting_names(model)
    if any(name.upper().startswith(PREFIX) for name in os.environ):
        others: dict[str, Collection[str] | None] = dict.fromkeys(sections())
        problem = unknown_variable(os.environ, {**others, service: fields})
        if problem:
            raise ConfigError(problem)
    filed = read_settings(path, {service: fields}).get(service, {}) if path else {}
    from_nav2 = nav2_settings(model, service, params_path) if params_path else {}
    values = merged(from_nav2, filed)
    if os.environ.get("MAZEBOT_SEED"):
        # One variable for the seed of all services.
        values = {**values, "seed": os.environ["MAZEBOT_SEED"]}
    if service == "bus" and os.environ.get(ROS_DOMAIN):
        values = {"domain_id": os.environ[ROS_DOMAIN], **values}
    prefix = f"{PREFIX}{service.upper()}_"
    try:
        if rest or any(name.upper().startswith(prefix) for name in os.environ):
            # This module takes long to import.
            from mazebot.common.settings.settings import settings  # noqa: PLC0415

            values = settings(model, service, rest, prefix, values)
        return model.model_validate(merged(values, given))
    except ValidationError as error:
        files = {path: filed, params_path: from_nav2}
        source = functools.partial(_source, service, rest, given, files, fields)
        raise ConfigError(f"{service}: {one_line(error, source, model)}") from error


def sections() -> tuple[str, ...]:
    """The sections that a settings file, and the environment variables, may have."""
    # Loads all messages, which takes a command 0.2 s.
    from mazebot.common.messages.topics import SERVICES  # noqa: PLC0415

    return ("bus", "console", "ros2_bridge", "router", *SERVICES)


def read_settings(
    path: Path, fields_of: Mapping[str, Collection[str] | None]
) -> dict[str, dict[str, Any]]:
    """The sections of a settings file, of the form

        seed: 8
        physics: {scan_rate_hz: 5}

    or those of a run's own config.yaml. Of the latter, folders that do not exist on this machine
    and the recorder's settings are left out.

    Raises ConfigError where a section, or a field of those in `fields_of`, is not known.
    """
    content = _yaml_mapping(path)
    of_a_run = isinstance(content.get("services"), dict)
    top, found = (content, content["services"]) if of_a_run else ({}, dict(content))
    common = {"seed": found.pop("seed")} if not of_a_run and "seed" in found else {}
    known = sections()
    strange = [name for name in found if name not in known and name not in fields_of]
    strange += [name for name in top if name not in _OF_A_RUN]
    if strange:
        hint = unknown_name(str(strange[0]), _OF_A_RUN if of_a_run else ("seed", *known))
        raise ConfigError(f"{path}: {strange[0]!s:.60}: unknown section{hint}")
    read: dict[str, dict[str, Any]] = {}
    for name in {**dict.fromkeys(fields_of), **found}:
        section = found.get(name, {})
        # The recorder's settings of a run are not used.
        unread = of_a_run and name == "recorder"
        _check_section(path, name, section, None if unread else fields_of.get(name))
        if of_a_run:
            read[name] = _to_repeat(name, section, content.get("seed"))
        else:
            read[name] = {**common, **section}
    return read


def _check_section(
    path: Path, name: str, section: Any, fields: Collection[str] | None, prefix: str = ""
) -> None:
    """Raises ConfigError where a section is not a mapping, or has a field not in `fields`."""
    if not isinstance(section, dict):
        reason = "must be a mapping of fields to values"
        raise ConfigError(f"{path}: {name}: {section!r:.60}: {reason}")
    if fields is None:
        return
    for field, value in section.items():
        dotted = f"{prefix}{field}"
        if dotted not in fields:
            where = f"{path}: {name}.{field!s:.60}: {value!r:.60}"
            raise ConfigError(
                f"{where}: unknown field{unknown_setting(str(field), fields, within=prefix)}"
            )
        if any(one.startswith(f"{dotted}.") for one in fields):
            _check_section(path, f"{name}.{field}", value, fields, f"{dotted}.")


def world_hash_of_run(path: Path) -> str:
    """The hash of the world of a run, from its config.yaml; empty for any other settings file.

    Raises ConfigError where it cannot be read.
    """
    return str(_yaml_mapping(path).get("world_hash", ""))


_OF_A_RUN = ("world_request", "world", "world_hash", "seed", "services")
"""The top-level keys of a run's config.yaml."""


def _to_repeat(name: str, section: Mapping[str, Any], seed: object) -> dict[str, Any]:
    """The settings that repeat a run: without the recorder's, and without folders that do not exist
    on this machine. Its seed may differ from the initial one, after a reset.
    """
    gone = {
        field for field in ("worlds_dir", "texture_base")
        if isinstance(section.get(field), str) and not Path(section[field]).is_dir()
    }  # fmt: skip
    kept = {field: value for field, value in section.items() if field not in gone}
    if name == "recorder":
        kept = {}
    return kept if seed is None else {**kept, "seed": seed}


def config_flag(path: Path | None, params: Path | None = None) -> tuple[str, ...]:
    """The arguments for `load` that name a settings file and a parameter file of Nav2."""
    named = (("--config", path), ("--params", params))
    return tuple(word for flag, file in named if file is not None for word in (flag, str(file)))


def _source(
    service: str, flags: Sequence[str], given: Mapping[str, object],
    files: Mapping[Path | None, Mapping[str, Any]], fields: Collection[str], field: str,
) -> str:  # fmt: skip
    """The flag, variable or file from which the value of a dotted name comes."""
    inside = [one for one in fields if f"{field}.".startswith(f"{one}.")]
    # A part of a value that is a list or a mapping comes from where that value does.
    setting = max(inside, key=len, default=field)
    if value_of(given, setting) is not None:
        return ""

    def is_of(name: str) -> bool:
        return any(one in inside for one in matching(name, fields))

    for word in flags:
        flag = word.partition("=")[0]
        if flag.startswith("--") and is_of(flag.removeprefix("--").replace("-", "_")):
            return flag
    prefix = variable(service, "")
    for name in os.environ:
        upper = name.upper()
        if (upper, field) in (("MAZEBOT_SEED", "seed"), (ROS_DOMAIN, "domain_id")):
            return name
        if upper.startswith(prefix):
            if is_of(upper.removeprefix(prefix).lower().replace("__", ".")):
                return name
    for path, values in files.items():
        *outer, last = setting.split(".")
        section = value_of(values, ".".join(outer)) if outer else values
        # A value that is empty is from there, too.
        if isinstance(section, Mapping) and last in section:
            return str(path)
    return ""


def _take_file_flag(arguments: Sequence[str], name: str) -> tuple[list[str], Path | None]:
    """The other arguments, and the file that `--<name>` or `MAZEBOT_<NAME>` names."""
    rest: list[str] = []
    flag = f"--{name}"
    path = os.environ.get(f"{PREFIX}{name.upper()}") or None
    words = iter(arguments)
    for word in words:
        if word == flag:
            path = next(words, None)
            if path is None:
                raise ConfigError(f"{flag}: must be followed by a file")
        elif word.startswith(f"{flag}="):
            path = word.partition("=")[2]
        else:
            rest.append(word)
    return rest, Path(path) if path else None


def read_nav2_params(path: Path) -> Nav2Params:
    """A parameter file of Nav2. Raises ConfigError where it cannot be read or is not valid."""
    return _nav2_params(_text(path, "Nav2's parameters"), str(path))


@functools.lru_cache(maxsize=1)
def _nav2_params(text: str, name: str) -> Nav2Params:
    """In one process every service reads the same file."""
    # Only those that name such a file need the tables.
    from mazebot.common.nav2_params.loader import load_nav2_params  # noqa: PLC0415

    return load_nav2_params(text, name)


def nav2_settings(model: type[ServiceConfig], service: str, path: Path) -> dict[str, Any]:
    """The settings of a service that come of a parameter file of Nav2. A line of the log tells
    which of the service's parameters there count otherwise.

    Raises ConfigError where it cannot be read or is not valid.
    """
    from mazebot.common.nav2_params.report import report  # noqa: PLC0415
    from mazebot.common.nav2_params.summary import summary  # noqa: PLC0415

    found = report(read_nav2_params(path), {service: model})
    said = summary(found, service)
    if said is not None:
        level, text = said
        logging.getLogger(service).log(level, text)
    return dict(found.settings.get(service, {}))


def _text(path: Path, kind: str) -> str:
    """The text of a file. Raises ConfigError."""
    try:
        return read_limited(path, MAX_TEXT_BYTES).decode()
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not YAML: must be UTF-8") from error
    except (OSError, NotReadableError) as error:
        what = f" of {kind}" if str(error) == "must be a file" else ""
        raise ConfigError(f"{path}: {reason(error)}{what}") from error


def _yaml_mapping(path: Path) -> dict[Any, Any]:
    """The content of a settings file. Raises ConfigError."""
    text = _text(path, "settings")
    try:
        content = bounded_yaml.load(text)
    except bounded_yaml.ERRORS as error:
        raise bounded_yaml.not_yaml(str(path), error) from error
    if content is None:
        raise ConfigError(f"{path}: is empty: must be sections with fields: {{seed: 8}}")
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: {content!r:.60}: must be a mapping of sections to their fields")
    return content
