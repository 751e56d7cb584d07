"""AssistedTeleop: drives as a user asks, slower where that would touch something."""

from __future__ import annotations

from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.motions.motion import (
    DONE,
    BehaviorServerParams,
    Moment,
    Motion,
    MotionStep,
    is_over,
    toward,
)
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.errors import NavigationError


class AssistedTeleop(Motion):
    """One session; its feedback is the time that it has run."""

    def __init__(self, params: BehaviorServerParams, time_allowance_s: float = 30.0) -> None:
        super().__init__()
        self._params = params
        self._time_allowance_s = time_allowance_s
        self._wanted: Velocity | None = None
        self._velocity = STOP
        self._finished = False

    def ask(self, velocity: Velocity | None) -> None:
        """Give the user's newest velocity; None: none lately, so stop."""
        self._wanted = velocity

    def finish(self) -> None:
        """End the session with success (Nav2's preempt_teleop)."""
        self._finished = True

    def _advance(self, at: Moment) -> MotionStep:
        p = self._params
        self.feedback = at.running_s
        if self._finished:
            return DONE
        if is_over(at.running_s, self._time_allowance_s):
            raise NavigationError(
                ErrorCode.ASSISTED_TELEOP_TIMEOUT,
                f"AssistedTeleop: exceeded the time allowance of {self._time_allowance_s:.1f} s",
            )
        asked = self._wanted or STOP
        v_most, w_most = p.teleop_linear_limit, p.teleop_angular_limit
        wanted = Velocity(
            min(max(asked.linear_m_s, -v_most), v_most),
            min(max(asked.angular_rad_s, -w_most), w_most),
        )
        if wanted != STOP:
            share = min(at.time_to_collision(wanted) / p.projection_time, 1.0)
            wanted = Velocity(wanted.linear_m_s * share, wanted.angular_rad_s * share)
        self._velocity = Velocity(
            toward(
                self._velocity.linear_m_s,
                wanted.linear_m_s,
                p.acceleration_limit * at.elapsed_s,
            ),
            toward(
                self._velocity.angular_rad_s,
                wanted.angular_rad_s,
                p.rotational_acc_lim * at.elapsed_s,
            ),
        )
        return MotionStep(False, self._velocity)
