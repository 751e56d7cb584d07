"""Models that a request names or holds."""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path

import pytest

from mazebot.common.messages.action_documents import ReadModel
from mazebot.common.messages.documents import BodyEntity, MarkerEntity
from mazebot.common.world.assets import assets_of
from mazebot.worldgen.models.model_reading import entity_of

LINK = "<link name='l'><collision name='c'><geometry>{}</geometry></collision></link>"
BOX = LINK.format("<box><size>1 1 1</size></box>")


def sdf(inner: str) -> str:
    return f"<sdf version='1.9'>{inner}</sdf>"


def test_files_of_a_model_come_with_it(tmp_path: Path) -> None:
    folder = tmp_path / "tetra"
    folder.mkdir()
    (folder / "model.config").write_text("<model><sdf version='1.9'>model.sdf</sdf></model>")
    (folder / "tetra.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    mesh = LINK.format("<mesh><uri>model://tetra/tetra.obj</uri></mesh>")
    (folder / "model.sdf").write_text(sdf(f"<model name='t'><static>1</static>{mesh}</model>"))
    reply = entity_of(ReadModel(model="tetra"), tmp_path)
    assert reply.error == ""
    assert isinstance(reply.entity, BodyEntity)
    assert (reply.entity.name, reply.entity.mass_kg) == ("t", 0.0)
    wanted = assets_of(reply.entity)
    assert wanted
    assert reply.assets.keys() == wanted.keys()
    for sha256, data in reply.assets.items():
        assert hashlib.sha256(base64.b64decode(data)).hexdigest() == sha256


@pytest.mark.parametrize(
    ("wanted", "says"),
    [
        (ReadModel(), "exactly one"),
        (ReadModel(model="a", text="<sdf/>"), "exactly one"),
        (ReadModel(model="no_such"), "'no_such'"),
        (ReadModel(text="<sdf"), "resource_string.sdf"),
        (ReadModel(text="junk"), "resource_string.urdf"),
        (ReadModel(text=sdf("<model name='a'><link name='l'/></model>")), "body"),
        (
            ReadModel(text=sdf(
                "<model name='a'>"
                + LINK.format("<mesh><uri>file:///etc/passwd</uri></mesh>") + "</model>"
            )),
            "/etc/passwd",
        ),
        (ReadModel(text="<!DOCTYPE a [<!ENTITY b 'c'>]><sdf>&b;</sdf>"), "resource_string.sdf"),
    ],
)  # fmt: skip
def test_what_is_no_model_is_said_in_one_line(wanted: ReadModel, says: str) -> None:
    reply = entity_of(wanted)
    assert says in reply.error
    assert "\n" not in reply.error
    assert "/tmp" not in reply.error
    assert reply.entity is None


@pytest.mark.parametrize("number", [60, 80])
def test_the_model_of_a_marker_is_a_marker(number: int) -> None:
    reply = entity_of(ReadModel(model=f"aruco_id_{number}"))
    assert isinstance(reply.entity, MarkerEntity), reply.error
    marker = reply.entity
    assert (marker.name, marker.marker_id) == (f"aruco_id_{number}", number)
    assert (marker.marker_size_m, marker.dictionary) == (0.3, "DICT_4X4_100")
    assert marker.texture_sha256 in reply.assets


def test_what_is_left_out_is_told(caplog: pytest.LogCaptureFixture) -> None:
    two = "".join(f"<model name='{name}'>{BOX}</model>" for name in "ab")
    reply = entity_of(ReadModel(text=sdf(two)))
    assert reply.entity is not None
    assert reply.entity.name == "a"
    assert "model a: left out: resource_string.sdf:1: model b: second <model>" in caplog.text
