"""The controllers by name, and how one is made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mazebot.common.config import ConfigError
from mazebot.navigation.control.controller import (
    Controller,
    ControllerParams,
    PathlessController,
    Robot,
    make_params,
)
from mazebot.navigation.control.mppi.mppi import MPPIController
from mazebot.navigation.control.plugins import load_plugin
from mazebot.navigation.control.regulated_pure_pursuit import RegulatedPurePursuitController

CONTROLLERS: Mapping[str, type[Any]] = {
    "mppi": MPPIController,
    "regulated_pure_pursuit": RegulatedPurePursuitController,
}


def controller_class(spec: str) -> type[Any]:
    """The class of a controller that a configuration names; raises ConfigError in one line."""
    found = load_plugin(spec, Controller, "controller", CONTROLLERS)
    if getattr(found, "command", None) is PathlessController.command:
        raise ConfigError(
            f"controller: {spec}: a PathlessController must have command(self, around)"
        )
    return found


def make_controller(
    spec: str,
    params: ControllerParams | Mapping[str, object],
    robot: Robot,
    random: np.random.Generator,
) -> Controller:
    """A controller by name.

    Args:
        spec: "mppi", "regulated_pure_pursuit", "my_package.my_module:MyController" or
            "FILE.py:MyController".
        params: its parameters, or a mapping of them to be checked by its `Params`.
        robot: what it must know of the robot.
        random: its one source of random numbers.

    Raises ConfigError in one line: see load_plugin; a parameter is unknown or out of range; the
    constructor raises.
    """
    made = controller_class(spec)
    if not isinstance(params, ControllerParams):
        params = make_params(made.Params, params, f"controller {spec}")
    try:
        controller: Controller = made(params, robot, random)
    except ConfigError:
        raise
    except Exception as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
        raise ConfigError(f"controller: {spec}: its constructor raised {text:.200}") from error
    return controller
