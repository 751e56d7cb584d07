"""Limits that contradict each other, and truth values in place of numbers, in any settings."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

import mazebot
from mazebot.common.config import ConfigError, Params, ServiceConfig, with_values
from mazebot.common.settings.load import load
from mazebot.localization.config import LocalizationConfig
from mazebot.navigation.config import NavigationConfig
from mazebot.perception.config import PerceptionConfig
from mazebot.physics.config import PhysicsConfig

CROSSED = ((0.9, 0.5), (20, 12), (300, 200), (-0.5, -0.9), (0, -1))
"""Least and greatest value: each pair's own limits allow some of these."""
OUTLINE = ((0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5))


def models() -> list[type[Params]]:
    """All classes of settings of the services."""
    for info in pkgutil.walk_packages(mazebot.__path__, "mazebot."):
        if info.name.rpartition(".")[2].endswith(("config", "params")):
            importlib.import_module(info.name)
    importlib.import_module("mazebot.navigation.node")
    return sorted(set(below(Params)), key=lambda one: one.__qualname__)


def below(model: type[Params]) -> Iterator[type[Params]]:
    for one in model.__subclasses__():
        if one.__module__.startswith("mazebot."):
            yield one
        yield from below(one)


def pairs() -> Iterator[tuple[type[Params], str, str]]:
    for model in models():
        for name, field in model.model_fields.items():
            words = ["max" if word == "min" else word for word in name.split("_")]
            other = "_".join(words)
            if other != name and other in model.model_fields and field.annotation in (int, float):
                yield model, name, other


def test_each_least_value_above_its_greatest_is_refused() -> None:
    found = [(model.__name__, least) for model, least, _ in pairs()]
    for pair in (
        ("LocalizationConfig", "laser_min_range"), ("DepthScanParams", "min_obstacle_height"),
        ("ScanSourceParams", "obstacle_min_range"), ("GracefulParams", "v_linear_min"),
        ("VelocityPolygonParams", "linear_min"), ("PhysicsConfig", "camera_depth_min_m"),
    ):  # fmt: skip
        assert pair in found
    for model, least, greatest in pairs():
        needed: dict[str, Any] = {
            name: OUTLINE if name == "points" else 0.0
            for name, field in model.model_fields.items()
            if field.is_required()
        }
        for low, high in CROSSED:
            with pytest.raises(ValidationError) as caught:
                model.model_validate({**needed, least: low, greatest: high})
            wrong = {error["loc"][0] for error in caught.value.errors()}
            assert wrong <= {least, greatest}, f"{model.__name__}: {least}, {greatest}: {wrong}"


@pytest.mark.parametrize(
    ("config", "text", "words"),
    [
        (LocalizationConfig, "{laser_min_range: 5, laser_max_range: 2}",
         "laser_min_range: must be at most laser_max_range, 2 (got 5.0 from"),
        (LocalizationConfig, "{min_returns: 1000}",
         "min_returns: must be at most max_beams, 90 (got 1000 from"),
        (LocalizationConfig, "{max_particles: 100}",
         "max_particles: must be at least min_particles, 500 (got 100 from"),
        (PerceptionConfig, "{depth_scan: {min_obstacle_height: 0.3}}",
         "depth_scan.min_obstacle_height: must be at most max_obstacle_height, 0.22 (got 0.3 from"),
        (PhysicsConfig, "{camera_depth_min_m: 1, camera_depth_max_m: 1}",
         "camera_depth_min_m: must be less than camera_depth_max_m, 1 (got 1.0 from"),
        (PhysicsConfig, "{scan_noise_m: true}",
         "scan_noise_m: must be a number, not true or false (got True from"),
        (LocalizationConfig, "{initial_pose: {x: yes}}", "initial_pose.x: must be a number"),
        (NavigationConfig, "{velocity_smoother: {max_velocity: [0.3, true]}}",
         "velocity_smoother.max_velocity: must be a number, not true or false"),
    ],
)  # fmt: skip
def test_the_one_line_names_field_value_file_and_what_would_be_right(
    config: type[ServiceConfig], text: str, words: str, tmp_path: Path
) -> None:
    section = config.__name__.removesuffix("Config").lower()
    file = tmp_path / "my.yaml"
    file.write_text(f"{section}: {text}\n")
    with pytest.raises(ConfigError) as caught:
        load(config, section, ["--config", str(file)])
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_value_set_while_it_runs_is_held_against_its_other_limit() -> None:
    name = "controller_server.regulated_pure_pursuit.min_lookahead_dist"
    with pytest.raises(ConfigError, match=rf"^{name}: must be at most max_lookahead_dist, 0.4"):
        with_values(NavigationConfig(), {name: 1.0})
