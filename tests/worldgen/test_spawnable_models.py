"""Which models are told as those that can be spawned."""

from __future__ import annotations

from pathlib import Path

import pytest

from mazebot.common.messages.action_documents import ReadModel
from mazebot.worldgen.models import model_reading
from mazebot.worldgen.models.model_entity import model_names, read_model
from mazebot.worldgen.models.spawnable_models import SpawnableModels

CRATE = (
    '<sdf version="1.9"><model name="{name}"><static>true</static><link name="l">'
    '<collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision>{more}'
    "</link></model></sdf>"
)
CONFIG = '<model><name>{name}</name><sdf version="1.9">model.sdf</sdf></model>'


def model(root: Path, name: str, more: str = "") -> Path:
    folder = root / name
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.config").write_text(CONFIG.format(name=name))
    (folder / "model.sdf").write_text(CRATE.format(name=name, more=more))
    return folder


def test_all_that_are_told_can_be_spawned_and_no_others_can(tmp_path: Path) -> None:
    model(tmp_path, "crate")
    model(tmp_path, "broken", "<collision/>")
    marker = model(tmp_path, "marker") / "model.sdf"
    noted = 'xmlns:mazebot="https://mazebot.example/sdf" mazebot:marker="x"'
    marker.write_text(
        marker.read_text().replace('<model name="marker"', f"<model {noted} name='m'")
    )
    told = SpawnableModels((tmp_path,)).answer()
    assert told.error == ""
    assert {"crate", "aruco_id_60"} <= set(told.names)
    for name in model_names((tmp_path,)):
        reply = model_reading.entity_of(ReadModel(model=name), tmp_path)
        assert (reply.error == "") == (name in told.names), name


def test_a_model_is_read_again_only_once_its_files_have_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model(tmp_path, "crate")
    models = SpawnableModels((tmp_path,))
    first = models.answer()
    read: list[str] = []

    def noted(folder: Path, *rest: object) -> object:
        read.append(folder.name)
        return read_model(folder, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr("mazebot.worldgen.models.spawnable_models.read_model", noted)
    assert models.answer() == first
    assert read == []
    model(tmp_path, "crate", "<collision/>")
    model(tmp_path, "post")
    assert set(models.answer().names) == {*first.names, "post"} - {"crate"}
    assert sorted(read) == ["crate", "post"]


def test_reading_many_goes_on_where_it_was_when_it_is_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(3):
        model(tmp_path, f"a{number}")
    models = SpawnableModels((tmp_path,))
    monkeypatch.setattr(f"{SpawnableModels.__module__}.MOST_MODELS", 2)
    replies = [models.answer() for _ in range(20)]
    assert (
        replies[0].error
        == f"2 of {len(model_names((tmp_path,)))} models are read: ask again for all of them"
    )
    assert replies[0].names == ()
    assert replies[-1].error == ""
    assert {"a0", "a1", "a2"} <= set(replies[-1].names)
    monkeypatch.setattr(f"{SpawnableModels.__module__}.MOST_BYTES", 1)
    assert SpawnableModels((tmp_path,)).answer().error.startswith("1 of ")
