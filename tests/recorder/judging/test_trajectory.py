"""Errors of a path, in cases that can be worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array
from mazebot.recorder.judging import trajectory as module
from mazebot.recorder.judging.trajectory import (
    Trajectory,
    absolute_error_m,
    aligned,
    relative_error,
    summed_up,
)


def circle(radius_m: float = 2.0, poses: int = 600) -> Array:
    turn = np.linspace(0.0, 3.0 * math.pi, poses)
    yaw = (turn + math.pi / 2 + math.pi) % (2 * math.pi) - math.pi
    return np.stack([radius_m * np.cos(turn), radius_m * np.sin(turn), yaw], axis=1)


def moved(poses: Array, by: SE2) -> Array:
    return np.array([by @ SE2(*pose) for pose in poses.tolist()])


def test_a_path_in_another_frame_has_no_error_but_that_of_the_frame() -> None:
    truths = circle()
    estimates = moved(truths, SE2(0.3, -0.4, 0.0))
    assert summed_up(absolute_error_m(estimates, truths)).rmse == pytest.approx(0.5)
    turned = moved(truths, SE2(0.3, -0.4, 0.2))
    assert absolute_error_m(aligned(turned, truths), truths).max() == pytest.approx(0.0, abs=1e-9)
    relative = relative_error(turned, truths)
    assert relative.apart_m.max() == pytest.approx(0.0, abs=1e-9)
    assert relative.turned_rad.max() == pytest.approx(0.0, abs=1e-9)


def test_a_scale_of_one_percent_is_a_centimetre_in_a_metre() -> None:
    truths = np.stack([np.linspace(0.0, 5.0, 501), np.zeros(501), np.zeros(501)], axis=1)
    estimates = truths * [1.01, 1.0, 1.0]
    relative = relative_error(estimates, truths)
    assert len(relative.apart_m) == 401
    assert relative.apart_m == pytest.approx(np.full(401, 0.01))
    errors = summed_up(absolute_error_m(estimates, truths))
    assert errors.max == pytest.approx(0.05)
    assert errors.p95 == pytest.approx(0.0475)
    # Of a line from 0 to a: a / sqrt(3).
    assert errors.rmse == pytest.approx(0.05 / math.sqrt(3), rel=1e-2)


def test_a_heading_that_drifts_is_in_the_relative_angle() -> None:
    truths = np.stack([np.linspace(0.0, 5.0, 501), np.zeros(501), np.zeros(501)], axis=1)
    # Across the jump of the angle from pi to -pi.
    truths[:, 2] = (3.1 + 0.1 * truths[:, 0] + math.pi) % (2 * math.pi) - math.pi
    estimates = truths.copy()
    estimates[:, 2] += 0.02 * truths[:, 0]
    assert relative_error(estimates, truths).turned_rad == pytest.approx(np.full(401, 0.02))


def test_nothing_driven_has_no_relative_error() -> None:
    at_rest = np.tile([1.0, 2.0, 0.3], (20, 1))
    assert summed_up(relative_error(at_rest, at_rest).apart_m).rmse is None
    nothing = np.zeros((0, 3))
    assert summed_up(absolute_error_m(aligned(nothing, nothing), nothing)).max is None
    assert not len(relative_error(nothing, nothing).apart_m)


def test_a_long_path_is_thinned_evenly_and_its_errors_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MOST", 64)
    path = Trajectory()
    for step in range(1000):
        path.add(SE2(0.01 * step, 0.1, 0.0), SE2(0.01 * step, 0.0, 0.0))
    assert 32 <= len(path.truths) <= 64
    steps = np.diff(path.truths[:, 0])
    assert steps == pytest.approx(np.full(len(steps), steps[0]))
    assert path.truths[-1, 0] > 9.8
    errors = absolute_error_m(path.estimates, path.truths)
    assert errors == pytest.approx(np.full(len(errors), 0.1))


def test_a_path_goes_on_from_its_state() -> None:
    whole, first, second = Trajectory(), Trajectory(), Trajectory()
    for step in range(10):
        pose = SE2(0.1 * step, 0.0, 0.0), SE2(0.1 * step, 0.01, 0.0)
        whole.add(*pose)
        (first if step < 5 else second).add(*pose)
        if step == 4:
            second.restore(first.state())
    assert np.array_equal(second.estimates, whole.estimates)
    assert np.array_equal(second.truths, whole.truths)
