"""A model that a request names or holds, as an entity that can be spawned."""

from __future__ import annotations

import base64
import logging
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from mazebot.common.config import ConfigError, one_line
from mazebot.common.messages.action_documents import ReadModel, ReadModelReply
from mazebot.common.messages.documents import BodyEntity, Marker, MarkerEntity
from mazebot.common.problems import words
from mazebot.common.world import marker_picture
from mazebot.common.world.marker_entities import drawn_marker
from mazebot.worldgen.models.model_entity import Model, named_model, read_model

_LOG = logging.getLogger("worldgen")
_TEXT = "resource_string"
"""How simulation_interfaces names the text of a model."""


def entity_of(wanted: ReadModel, *roots: Path) -> ReadModelReply:
    """The model with its files, or why there is none. `roots`: folders of models, if they exist."""
    try:
        if bool(wanted.model) == bool(wanted.text):
            raise ConfigError("model, text: exactly one of them must be given")
        model = (
            read_model(named_model(wanted.model, roots), roots)
            if wanted.model
            else _of_text(wanted.text, roots)
        )
        entity, files = entity_in(model)
    except ConfigError as error:
        return ReadModelReply(error=str(error))
    for line in (*model.missing, *model.ignored):
        _LOG.warning("model %s: left out: %s", model.name, line)
    assets = {name: base64.b64encode(data).decode() for name, data in files.items()}
    return ReadModelReply(entity=entity, assets=assets)


def entity_in(model: Model) -> tuple[BodyEntity | MarkerEntity, dict[str, bytes]]:
    """What a model becomes in a world, and its files by sha256. Raises ConfigError."""
    try:
        return _marker_of(model) if model.marker else _body_of(model)
    except ValidationError as error:
        raise ConfigError(words(one_line(error))) from error


def _body_of(model: Model) -> tuple[BodyEntity, dict[str, bytes]]:
    entity = BodyEntity(
        name=model.name, position_m=(0.0, 0.0, 0.0), mass_kg=model.mass_kg,
        shapes=model.shapes, materials=model.materials,
    )  # fmt: skip
    return entity, model.assets


def _marker_of(model: Model) -> tuple[MarkerEntity, dict[str, bytes]]:
    """Raises ConfigError, and ValidationError."""
    noted = {"quiet_zone_modules": "1", **model.marker}
    try:
        number, zone = int(noted["marker"]), int(noted["quiet_zone_modules"])
        size_m, dictionary = float(noted["size_m"]), noted["dictionary"]
    except (KeyError, ValueError) as error:
        raise ConfigError(f"{model.name}: is a marker's model without its size and id") from error
    marker = Marker(
        id=number, size_m=size_m, dictionary=dictionary, quiet_zone_modules=zone,
        wall="", side="left", offset_m=0.0, height_m=0.0,
    )  # fmt: skip
    problem = marker_picture.identity_problem(marker)
    if problem:
        raise ConfigError(f"{model.name}: {problem}")
    return drawn_marker(model.name, marker, np.eye(4))


def _of_text(text: str, roots: Sequence[Path]) -> Model:
    """Raises ConfigError."""
    suffix = "sdf" if "<sdf" in text else "urdf"
    with tempfile.TemporaryDirectory(prefix="model-") as folder:
        file = Path(folder) / f"{_TEXT}.{suffix}"
        file.write_text(text, encoding="utf-8", errors="replace")
        try:
            return read_model(file, roots)
        except ConfigError as error:
            raise ConfigError(str(error).replace(f"{folder}/", "")) from error
