"""Calls of a user's own class: what it raises, or returns wrongly, names the class and its line."""

from __future__ import annotations

import inspect
import math
import sysconfig
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from mazebot.common.config import ConfigError
from mazebot.common.files.root import ROOT
from mazebot.common.maths.frames import SE2, Array
from mazebot.navigation.control.collision import Surroundings, Velocity
from mazebot.navigation.control.controller import (
    Control,
    Controller,
    ControllerParams,
    TakesOver,
)
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.interface import GlobalPlanner, PlannerParams
from mazebot.navigation.planning.path import PlannedPath, dense, path_through

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
            if not isinstance(error, (*passed, OwnClassError)):
                raise self._raised(method, error) from error
            if isinstance(error, NavigationError) and not _is_code(error.code):
                must = "a number above 0, such as ErrorCode.NO_VALID_PATH"
                what = f"raised NavigationError with the code {error.code!r:.40}"
                raise self.wrong(method, what, must) from error
            raise

    def refused(self, method: str, value: object, must: str, part: str = "") -> OwnClassError:
        """The error of a value that a method has returned, or of a part of it."""
        shown = " ".join(repr(value).split())
        return self.wrong(method, f"returned {part}{shown:.120}", must)

    def wrong(self, method: str, what: str, must: str) -> OwnClassError:
        """The error of a call that did something wrong."""
        return OwnClassError(
            f"{self._what}: {self._line_of(method)}: {method}() {what}: must be {must}"
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


def _is_code(value: object) -> bool:
    """Whether it is a code of an action's result, a uint16, and not 0: that is success."""
    return isinstance(value, int) and 0 < value < 2**16


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and math.isfinite(value)


def is_velocity(value: object) -> bool:
    """Whether a value is a Velocity, or two numbers that are finite."""
    return (
        isinstance(value, tuple)
        and len(value) == len(Velocity._fields)
        and all(map(_is_number, value))
    )


def _as_velocity(value: tuple[float, float]) -> Velocity:
    return Velocity(*map(float, value))


def _is_flag(value: object) -> bool:
    return isinstance(value, bool | np.bool_)


class OwnController:
    """A user's controller, whose every call is checked. What it is given is its own: what it
    writes there, the rest of navigation does not see.
    """

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
            path = self._controller.path
        if not isinstance(path, PlannedPath | None):
            raise self._own.refused("path", path, "the PlannedPath that it was given, or None")
        return path

    @property
    def index(self) -> int:
        """See Controller."""
        with self._own.calling("index"):
            return int(self._controller.index)

    @property
    def xy_reached(self) -> bool:
        """See Controller."""
        with self._own.calling("xy_reached"):
            reached = self._controller.xy_reached
        if not _is_flag(reached):
            raise self._own.refused("xy_reached", reached, "True or False")
        return bool(reached)

    @property
    def velocity(self) -> Velocity:
        """See Controller."""
        with self._own.calling("velocity"):
            velocity = self._controller.velocity
        if not is_velocity(velocity):
            raise self._own.refused("velocity", velocity, _VELOCITY)
        return _as_velocity(velocity)

    def set_path(self, path: PlannedPath, same_goal: bool) -> None:
        """See Controller."""
        with self._own.calling("set_path", NavigationError):
            self._controller.set_path(deepcopy(path), same_goal)

    def take_over(self, velocity: Velocity, index: int = 0, xy_reached: bool = False) -> None:
        """See TakesOver; one that cannot begins as it was made."""
        if isinstance(self._controller, TakesOver):
            with self._own.calling("take_over"):
                self._controller.take_over(velocity, index, xy_reached)

    def step(self, elapsed_s: float, around: Surroundings) -> Control:
        """See Controller."""
        with self._own.calling("step", NavigationError):
            made = self._controller.step(elapsed_s, deepcopy(around))
        if not isinstance(made, Control) or not is_velocity(made.velocity):
            must = "a Control, with a Velocity of two finite numbers"
            raise self._own.refused("step", made, must)
        for name in ("reached", "blocked"):
            flag = getattr(made, name)
            if not _is_flag(flag):
                raise self._own.refused("step", flag, "True or False", f"a Control with {name} ")
        left_m = made.distance_remaining_m
        if not _is_number(left_m) or left_m < 0.0:
            must, part = "a finite number of at least 0", "a Control with distance_remaining_m "
            raise self._own.refused("step", left_m, must, part)
        return Control(
            _as_velocity(made.velocity), bool(made.reached), bool(made.blocked),
            float(left_m),
        )  # fmt: skip

    def stop(self) -> None:
        """See Controller."""
        with self._own.calling("stop"):
            self._controller.stop()


_VELOCITY = "a Velocity of two finite numbers"


def _check_command(controller: Any, own: OwnClass) -> None:
    """Check what the method returns that a class derived from one of Mazebot's bases defines: the
    base computes with it before anybody else sees it.
    """
    for method, must, is_right, as_made in (
        ("command", _VELOCITY, is_velocity, _as_velocity),
        (
            "_drive", f"{_VELOCITY}, and whether the way is blocked", _is_drive,
            lambda made: (_as_velocity(made[0]), bool(made[1])),
        ),
    ):  # fmt: skip
        if not hasattr(controller, method):
            continue
        inner = getattr(controller, method)

        def checked(
            *given: Any, inner: Any = inner, method: str = method, must: str = must,
            is_right: Any = is_right, as_made: Any = as_made,
        ) -> Any:  # fmt: skip
            with own.calling(method, NavigationError):
                made = inner(*given)
            if not is_right(made):
                raise own.refused(method, made, must)
            return as_made(made)

        setattr(controller, method, checked)


def _is_drive(value: object) -> bool:
    return (
        isinstance(value, tuple)
        and len(value) == 2
        and is_velocity(value[0])
        and _is_flag(value[1])
    )


class OwnPlanner:
    """A user's planner, whose every call is checked, and whose costmap is its own."""

    def __init__(self, spec: str, planner: GlobalPlanner, params: PlannerParams) -> None:
        self._own = OwnClass("planner", spec, type(planner))
        self._planner = planner
        self._params = params

    def plan(
        self, costmap: Costmap, start: SE2, goal: SE2, tolerance_m: float = 0.0
    ) -> PlannedPath:
        """See GlobalPlanner."""
        with self._own.calling("plan", NavigationError):
            path = self._planner.plan(deepcopy(costmap), start, goal, tolerance_m)
        must = "a PlannedPath of two points or more, (n, 2), with n yaws, all finite"
        if not isinstance(path, PlannedPath):
            raise self._own.refused("plan", path, must)
        with self._own.calling("plan"):
            parts = (path.points_m, path.yaws_rad, path.along_m, (path.cost_m, path.way_out_m))
            points_m, yaws_rad, along_m, lengths_m = (np.array(part, np.float64) for part in parts)
        count = len(points_m)
        shapes = (points_m.shape, yaws_rad.shape, along_m.shape)
        if count < 2 or shapes != ((count, 2), (count,), (count,)):
            raise self._own.wrong("plan", f"returned shapes {shapes}", must)
        if not all(np.isfinite(part).all() for part in (points_m, yaws_rad, along_m, lengths_m)):
            raise self._own.wrong("plan", "returned a number that is not finite", must)
        exact_m = path_through(points_m, 0.0).along_m
        if np.abs(along_m - exact_m).max() > _ALONG_ERROR * (1.0 + exact_m[-1]):
            must = "the length of the path up to each point, as path_through() makes it"
            raise self._own.wrong("plan", "returned along_m that is not right", must)
        self._check_ends(points_m, costmap.frame.resolution_m, start, goal, tolerance_m)
        return dense(replace(path, points_m=points_m, yaws_rad=yaws_rad, along_m=exact_m))

    def _check_ends(
        self, points_m: Array, cell_m: float, start: SE2, goal: SE2, tolerance_m: float
    ) -> None:
        """A path that leads elsewhere would be driven, and its end taken for the goal."""
        settings = self._params.settings
        for name, place, wanted, within_m in (
            ("begins", points_m[0], start, settings.start_tolerance),
            ("ends", points_m[-1], goal, max(tolerance_m, settings.tolerance)),
        ):
            x_m, y_m = place.tolist()
            if math.hypot(x_m - wanted.x_m, y_m - wanted.y_m) > within_m + _END_CELLS * cell_m:
                raise self._own.wrong(
                    "plan",
                    f"returned a path that {name} at ({x_m:.2f}, {y_m:.2f})",
                    f"one that {name} at ({wanted.x_m:.2f}, {wanted.y_m:.2f})",
                )


_ALONG_ERROR = 1e-3
"""Of the path's length and 1 m: single precision is near enough."""
_END_CELLS = 2.0
"""So many cells away from where it should be, an end of a path may lie: in a cell's centre."""
