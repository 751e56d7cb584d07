"""Events when a contact of the robot begins."""

from __future__ import annotations

from collections.abc import Iterable

from mazebot.common.messages.documents import Contact
from mazebot.physics.bodies.bodies import Touch


class ContactEvents:
    """Reports a contact once, and again only if link and body were apart for `debounce_ns`."""

    def __init__(self, debounce_ns: int = 200_000_000) -> None:
        self._debounce_ns = debounce_ns
        self._last_ns: dict[tuple[str, str], int] = {}

    def restart_clock(self, now_ns: int) -> None:
        """Set the time from `now_ns` back to 0; every contact keeps its age."""
        self._last_ns = {pair: last_ns - now_ns for pair, last_ns in self._last_ns.items()}

    def begun(self, touches: Iterable[Touch], now_ns: int, step_s: float) -> list[Contact]:
        """The contacts that begin in the step that ends at `now_ns`: one for each link and body.

        The position is that of the point with the highest force, the impulse that of all points in
        this step. Nothing bounces, so it is the whole momentum that a wall takes from the robot:
        m v, or up to a tenth or a seventh more, added by the tyres and the turning wheels.
        """
        pairs: dict[tuple[str, str], list[Touch]] = {}
        for touch in touches:
            pairs.setdefault((touch.robot_link, touch.body), []).append(touch)
        contacts = []
        for pair, points in pairs.items():
            last_ns = self._last_ns.get(pair)
            self._last_ns[pair] = now_ns
            if last_ns is not None and now_ns - last_ns < self._debounce_ns:
                continue
            strongest = max(points, key=lambda point: point.force_n)
            contacts.append(
                Contact(
                    time_s=now_ns * 1e-9,
                    robot_link=pair[0],
                    body=pair[1],
                    position_m=strongest.position_m,
                    impulse_n_s=sum(point.force_n for point in points) * step_s,
                )
            )
        return contacts
