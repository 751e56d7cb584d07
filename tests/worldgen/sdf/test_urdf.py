"""What is legal in URDF and not in SDF."""

from __future__ import annotations

from pathlib import Path

import pytest

from mazebot.worldgen.sdf.model import SdfWorld
from mazebot.worldgen.sdf.reading.read import read_sdf

BOX = '<geometry><box size="0.4 0.4 0.1"/></geometry>'


def link(name: str, mass: str | None = None) -> str:
    inertial = "" if mass is None else f'<inertial><mass value="{mass}"/></inertial>'
    return f'<link name="{name}">{inertial}<collision>{BOX}</collision></link>'


def joint(name: str, parent: str, child: str) -> str:
    return (
        f'<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        '<origin xyz="0 0 1"/></joint>'
    )


def read(tmp_path: Path, inside: str) -> SdfWorld:
    file = tmp_path / "thing.urdf"
    file.write_text(f'<?xml version="0.0" ?>\n<robot name="thing">{inside}</robot>')
    world = read_sdf(file)
    assert world.report.errors == ()
    return world


@pytest.mark.parametrize("mass", ["0", ".0", "0.0"])
def test_what_weighs_nothing_stands_still(tmp_path: Path, mass: str) -> None:
    (tray,) = read(tmp_path, link("tray", mass)).links
    assert tray.static
    (box,) = read(tmp_path, link("tray", "0.5")).links
    assert not box.static
    assert box.mass_kg == 0.5


def test_a_part_that_weighs_nothing_is_a_light_one(tmp_path: Path) -> None:
    base, sensor = read(
        tmp_path, link("base", "2") + link("sensor", "0") + joint("j", "base", "sensor")
    ).links
    assert not base.static
    assert base.mass_kg == 2.0
    assert 0.0 < sensor.mass_kg < 0.001


def test_a_joint_may_have_the_name_of_a_link(tmp_path: Path) -> None:
    names = ("wheel", "wheel_joint")
    links = link("base", "1") + "".join(link(name, "1") for name in names)
    joints = "".join(joint(name, "base", name) for name in names)
    world = read(tmp_path, links + joints)
    assert [one.name for one in world.links] == ["thing::base", *(f"thing::{n}" for n in names)]
    assert [one.world_from_link[2, 3] for one in world.links] == [0.0, 1.0, 1.0]
