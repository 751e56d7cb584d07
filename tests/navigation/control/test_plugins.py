from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mazebot.common.config import ConfigError
from mazebot.navigation.control.controller import Controller, Robot
from mazebot.navigation.control.controllers import CONTROLLERS, controller_class, make_controller
from mazebot.navigation.control.mppi.critic_params import MPPIParams
from mazebot.navigation.control.mppi.mppi import MPPIController
from mazebot.navigation.control.plugins import load_plugin

RANDOM = np.random.default_rng(0)
COMPLETE = """
from mazebot.navigation.control.controller import PathlessController
from mazebot.navigation.control.collision import Velocity
class Mine(PathlessController):
    def command(self, around):
        return Velocity(0.1, 0.0)
class Raises(Mine):
    def __init__(self, params, robot, random):
        raise RuntimeError("no motor")
class Empty:
    def step(self, elapsed_s, around): ...
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "mine.py").write_text(COMPLETE)
    (tmp_path / "breaks.py").write_text("x = 1\ny = [][3]\n")
    (tmp_path / "bad.py").write_text("def f(:\n")
    (tmp_path / "exits.py").write_text("raise SystemExit(1)\n")
    (tmp_path / "my_module_of_controllers.py").write_text(COMPLETE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("spec", ["mine.py:Mine", "my_module_of_controllers:Mine"])
def test_a_users_class_is_loaded_from_a_file_or_a_module(folder: Path, spec: str) -> None:
    controller = make_controller(spec, {}, Robot(), RANDOM)
    assert isinstance(controller, Controller)
    assert type(controller).__name__ == "Mine"


@pytest.mark.parametrize("name", CONTROLLERS)
def test_mazebots_controllers_have_the_whole_interface(name: str) -> None:
    assert isinstance(make_controller(name, {}, Robot(), RANDOM), Controller)


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("mpi", "controller: 'mpi': must be one of mppi, regulated_pure_pursuit, my_package"),
        ("nowhere.py:Mine", "nowhere.py: no such file"),
        ("mine.py:Yours", "mine.py has no class Yours; it has Empty, Mine, Raises"),
        ("mine.py:COMPLETE", "mine.py has no class COMPLETE"),
        ("no_such_package.part:Mine", "no module no_such_package can be imported"),
        ("mine.py:Empty", "a controller must have Params, index, path, set_path, stop, velocity"),
        ("breaks.py:Mine", "raises on import: breaks.py line 2: IndexError: list index out"),
        ("bad.py:Mine", "raises on import: line 1: SyntaxError"),
        ("exits.py:Mine", "raises on import: exits.py line 1: SystemExit: 1"),
        ("mine.py:", "must be one of"),
    ],
)
def test_what_is_wrong_with_a_name_is_said_in_one_line(folder: Path, spec: str, said: str) -> None:
    with pytest.raises(ConfigError) as raised:
        controller_class(spec)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 400


def test_a_constructor_that_raises_is_named(folder: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"mine.py:Raises: its constructor raised RuntimeError: no"
    ):
        make_controller("mine.py:Raises", {}, Robot(), RANDOM)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"batch_size": 1}, "controller mppi: batch_size: must be greater than or equal to 50"),
        ({"model_dt": 0.02}, "mppi: model_dt: must be at least the control period of 0.05 s (got"),
        ({"batch_sise": 9}, "controller mppi: batch_sise: Extra inputs are not permitted (got 9)"),
        ({"vx_max": float("nan")}, "controller mppi: vx_max: must be a finite number"),
        ({"CostCritic": {"cost_weight": -1}}, "controller mppi: CostCritic.cost_weight: must be"),
    ],
)
def test_a_wrong_parameter_is_an_error_by_name(values: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError) as raised:
        make_controller("mppi", values, Robot(), RANDOM)
    assert str(raised.value).startswith(said)


def test_parameters_that_are_checked_already_are_taken() -> None:
    params = MPPIParams(batch_size=100)
    made = make_controller("mppi", params, Robot(), RANDOM)
    assert isinstance(made, MPPIController)
    assert made.batch_size == 100


def test_any_protocol_may_be_asked_for(folder: Path) -> None:
    class Planner:
        def plan(self) -> None: ...

    with pytest.raises(ConfigError, match="a planner must have plan"):
        load_plugin("mine.py:Mine", Planner, "planner")
