"""A hash of a run: equal if two runs moved everything alike to the last bit."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable

from mazebot.physics.bodies.body_state import BodyState, MoverState

_PACK = struct.Struct("<17d").pack
_PACK_MOVER = struct.Struct("<13d").pack


class StateHash:
    """blake2b over the states of the robot and the moving bodies after each step."""

    def __init__(self) -> None:
        self._hash = hashlib.blake2b(digest_size=8)

    def add(self, state: BodyState, movers: Iterable[MoverState] = ()) -> None:
        """Add the state after a step."""
        self._hash.update(
            _PACK(
                *state.position_m,
                *state.orientation_xyzw,
                *state.velocity_m_s,
                *state.angular_velocity_rad_s,
                *state.wheel_angles_rad,
                *state.wheel_speeds_rad_s,
            )
        )
        for mover in movers:
            self._hash.update(
                _PACK_MOVER(
                    *mover.position_m,
                    *mover.orientation_xyzw,
                    *mover.velocity_m_s,
                    *mover.angular_velocity_rad_s,
                )
            )

    def hex(self) -> str:
        """The hash of all states so far, 16 hex digits."""
        return self._hash.hexdigest()
