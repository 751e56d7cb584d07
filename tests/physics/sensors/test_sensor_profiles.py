"""A profile gives what nobody set, and what somebody set wins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path

import pytest
from pydantic import ValidationError

from mazebot.common.config import ConfigError
from mazebot.common.settings.load import load
from mazebot.physics.config import PhysicsConfig
from mazebot.physics.node import PhysicsNode
from mazebot.physics.sensor_profiles import (
    CAMERA_PROFILES,
    SCAN_PROFILES,
    CameraProfile,
    ScanProfile,
)

PROFILES: Mapping[str, Mapping[str, ScanProfile | CameraProfile]] = {
    "scan_profile": SCAN_PROFILES,
    "camera_profile": CAMERA_PROFILES,
}
EVERY = [(field, name) for field, profiles in PROFILES.items() for name in profiles]


@pytest.mark.parametrize(("field", "name"), EVERY)
def test_a_profile_gives_all_its_figures(field: str, name: str) -> None:
    config = PhysicsConfig.model_validate({field: name}).model_dump()
    figures = asdict(PROFILES[field][name])
    assert {key: config[key] for key in figures} == figures


@pytest.mark.parametrize("field", PROFILES)
def test_the_defaults_are_those_of_the_default_profile(field: str) -> None:
    """So that --help tells the truth."""
    infos = PhysicsConfig.model_fields
    profile = PROFILES[field][infos[field].default]
    for one in fields(profile):
        assert infos[one.name].default == getattr(profile, one.name)
    assert PhysicsConfig() == PhysicsConfig.model_validate({field: infos[field].default})


@pytest.mark.parametrize(("field", "name"), EVERY)
def test_every_profile_can_be_chosen(field: str, name: str) -> None:
    assert getattr(PhysicsConfig.model_validate({field: name}), field) == name
    choices = PhysicsConfig.model_json_schema()["properties"][field]["enum"]
    assert sorted(choices) == sorted(PROFILES[field])


def test_what_is_set_wins_from_wherever_it_comes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "config.yaml"
    file.write_text("physics: {scan_profile: lds02, scan_samples: 180, scan_noise_m: 0}\n")
    monkeypatch.setenv("MAZEBOT_PHYSICS_SCAN_RATE_HZ", "10")
    config = load(PhysicsConfig, "physics", [f"--config={file}", "--scan-range-max-m", "6.5"])
    assert (config.scan_samples, config.scan_noise_m) == (180, 0.0)
    assert (config.scan_rate_hz, config.scan_range_max_m) == (10.0, 6.5)
    assert (config.scan_profile, config.scan_range_min_m) == ("lds02", 0.16)


def test_an_unknown_profile_is_named_with_what_there_is() -> None:
    with pytest.raises(ConfigError) as caught:
        load(PhysicsConfig, "physics", ["--scan-profile", "lds03"])
    assert str(caught.value) == (
        "physics: scan_profile: must be 'lds01', 'lds02' or 'gazebo' "
        "(got 'lds03' from --scan-profile)"
    )


@pytest.mark.parametrize("value", [None, 3, ["lds01"], {"lds01": 1}])
def test_a_profile_that_is_no_name_is_refused(value: object) -> None:
    with pytest.raises(ValidationError, match="scan_profile"):
        PhysicsConfig.model_validate({"scan_profile": value})


def test_the_effective_figures_are_the_parameters() -> None:
    node = PhysicsNode(PhysicsConfig(scan_profile="gazebo", renderer="none"))
    values = node.parameters().values
    assert (values["scan_profile"], values["scan_rate_hz"]) == ("gazebo", 5.0)
    assert (values["scan_range_min_m"], values["scan_range_max_m"]) == (1e-5, 20.0)
    node.close()
