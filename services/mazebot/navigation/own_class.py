"""Calls of a user's own class: what it raises, or returns wrongly, names the class and its line."""

from __future__ import annotations

import inspect
import math
import sysconfig
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from mazebot.common.config import ConfigError
from mazebot.common.files.root import ROOT
from mazebot.common.maths.frames import SE2
from mazebot.navigation.control.collision import Surroundings, Velocity
from mazebot.navigation.control.controller import Control, Controller, ControllerParams
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.interface import GlobalPlanner
from mazebot.navigation.planning.path import PlannedPath

_NOT_THEIRS = (
    str(Path(__file__).parents[1]),
    *(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")),
)


class OwnClassError(ConfigError):
    """What a user's class has done wrong: one line, and in `details` its own lines of the
    traceback.
    """


class OwnClass:
    """A class of a user's own, as the configuration names it."""

    def __init__(self, kind: str, spec: str, made: type[Any]) -> None:
        """`kind`: controller, planner, ..., for errors."""
        self._what = f"{kind} {spec:.120}"
        self._class = made

    @contextmanager
    def calling(self, method: str, *passed: type[Exception]) -> Iterator[None]:
        """Runs a call of a method. What it raises, but for `passed`, becomes an OwnClassError."""
        try:
            yield
        except Exception as error:
            if isinstance(error, (*passed, OwnClassError)):
                raise
            raise self._raised(method, error) from error

    def refused(self, method: str, value: object, must: str) -> OwnClassError:
        """The error of a value that a method has returned."""
        shown = " ".join(repr(value).split())
        return OwnClassError(
            f"{self._what}: {self._line_of(method)}: {method}() returned {shown:.120}: must be "
            f"{must}"
        )

    def _raised(self, method: str, error: Exception) -> OwnClassError:
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if _is_theirs(frame.filename)]
        line = f"{_shown(own[-1].filename)}:{own[-1].lineno}" if own else self._line_of(method)
        text = " ".join(str(error).split())
        refused = OwnClassError(
            f"{self._what}: {line}: {method}() raised {type(error).__name__}: {text:.200}"
        )
        refused.details = "".join(traceback.format_list(own)).rstrip()
        return refused

    def _line_of(self, method: str) -> str:
        """The file and the line where a method, or else the class, is defined."""
        found = inspect.unwrap(getattr(self._class, method, self._class))
        try:
            file, line = inspect.getsourcefile(found), inspect.getsourcelines(found)[1]
        except (OSError, TypeError):
            return self._class.__module__
        return f"{_shown(file or '')}:{line}"


def _is_theirs(file: str) -> bool:
    return not file.startswith(("<", *_NOT_THEIRS))


def _shown(file: str) -> str:
    """A path from the working directory on, where it lies below."""
    try:
        return str(Path(file).relative_to(Path.cwd()))
    except (ValueError, OSError):
        return file.removeprefix(f"{ROOT}/")


def is_velocity(value: object) -> bool:
    """Whether a value is a Velocity, or two numbers that are finite."""
    return (
        isinstance(value, tuple)
        and len(value) == len(Velocity._fields)
        and all(isinstance(each, float | int | np.floating) for each in value)
        and all(map(math.isfinite, value))
    )


class OwnController:
    """A user's controller, whose every call is checked."""

    Params: ClassVar[type[ControllerParams]] = ControllerParams

    def __init__(self, spec: str, controller: Controller) -> None:
        self._own = OwnClass("controller", spec, type(controller))
        self._controller = controller
        _check_command(controller, self._own)

    def __getattr__(self, name: str) -> Any:
        """What else it has, such as an MPPIController's `batch_size`."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._controller, name)

    def __setattr__(self, name: str, value: object) -> None:
        """Set what is not of this class itself where it belongs."""
        if name.startswith("_"):
            super().__setattr__(name, value)
        else:
            setattr(self._controller, name, value)

    @property
    def path(self) -> PlannedPath | None:
        """See Controller."""
        with self._own.calling("path"):
            return self._controller.path

    @property
    def index(self) -> int:
        """See Controller."""
        with self._own.calling("index"):
            return int(self._controller.index)

    @property
    def xy_reached(self) -> bool:
        """See Controller."""
        with self._own.calling("xy_reached"):
            return bool(self._controller.xy_reached)

    @property
    def velocity(self) -> Velocity:
        """See Controller."""
        with self._own.calling("velocity"):
            return self._controller.velocity

    def set_path(self, path: PlannedPath, same_goal: bool) -> None:
        """See Controller."""
        with self._own.calling("set_path", NavigationError):
            self._controller.set_path(path, same_goal)

    def step(self, elapsed_s: float, around: Surroundings) -> Control:
        """See Controller."""
        with self._own.calling("step", NavigationError):
            made = self._controller.step(elapsed_s, around)
        if not isinstance(made, Control) or not is_velocity(made.velocity):
            must = "a Control, with a Velocity of two finite numbers"
            raise self._own.refused("step", made, must)
        return made

    def stop(self) -> None:
        """See Controller."""
        with self._own.calling("stop"):
            self._controller.stop()


def _check_command(controller: Any, own: OwnClass) -> None:
    """Check what the method returns that a class derived from one of Mazebot's bases defines: the
    base computes with it before anybody else sees it.
    """
    for method, must, is_right in (
        ("command", "a Velocity of two finite numbers", is_velocity),
        ("_drive", "a Velocity of two finite numbers, and whether the way is blocked", _is_drive),
    ):
        if not hasattr(controller, method):
            continue
        inner = getattr(controller, method)

        def checked(
            *given: Any, inner: Any = inner, method: str = method, must: str = must,
            is_right: Any = is_right,
        ) -> Any:  # fmt: skip
            with own.calling(method, NavigationError):
                made = inner(*given)
            if not is_right(made):
                raise own.refused(method, made, must)
            return made

        setattr(controller, method, checked)


def _is_drive(value: object) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and is_velocity(value[0])


class OwnPlanner:
    """A user's planner, whose every call is checked."""

    def __init__(self, spec: str, planner: GlobalPlanner) -> None:
        self._own = OwnClass("planner", spec, type(planner))
        self._planner = planner

    def plan(
        self, costmap: Costmap, start: SE2, goal: SE2, tolerance_m: float = 0.0
    ) -> PlannedPath:
        """See GlobalPlanner."""
        with self._own.calling("plan", NavigationError):
            path = self._planner.plan(costmap, start, goal, tolerance_m)
        must = "a PlannedPath of two points or more, (n, 2), with n yaws, all finite"
        if not isinstance(path, PlannedPath):
            raise self._own.refused("plan", path, must)
        with self._own.calling("plan"):
            points_m, yaws_rad = np.asarray(path.points_m, float), np.asarray(path.yaws_rad, float)
            along_m = np.asarray(path.along_m, float)
        count = len(points_m)
        shapes = (points_m.shape, yaws_rad.shape, along_m.shape)
        if count < 2 or shapes != ((count, 2), (count,), (count,)):
            raise self._own.refused("plan", f"shapes {shapes}", must)
        if not all(np.isfinite(part).all() for part in (points_m, yaws_rad, along_m)):
            raise self._own.refused("plan", "a number that is not finite", must)
        return path
