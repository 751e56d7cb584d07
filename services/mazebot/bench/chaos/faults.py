"""The faults that are done to a stack, and what is promised of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final, Literal

from mazebot.bench.chaos.links import Shape
from mazebot.bench.chaos.machines import Machine
from mazebot.bench.chaos.stacks import EXPLORING, SERVICES, Stack

Kind = Literal[
    "kill", "freeze", "cut", "restart", "starve", "squeeze", "late", "half-open", "delay", "slow",
    "clock", "disk",
]  # fmt: skip

STOP_S: Final = 0.25
"""From the loss of navigation, which commands the robot, to its rest."""
_ALL: Final = ""
"""In place of a service."""
SHAPES: Final[dict[Kind, Shape]] = {
    "half-open": Shape(is_open=False),
    "delay": Shape(delay_s=0.1, jitter_s=0.1),
    "slow": Shape(rate_bytes_s=125_000.0),
}
"""Of links: the second one way, the third 1 Mbit/s."""
MACHINES: Final[dict[Kind, Machine]] = {
    "clock": Machine(added_s=3600),
    "disk": Machine(disk_bytes_s=100_000),
}
"""What services see of theirs."""
_BACK_S: Final = {"router": 2.0, "navigation": 3.0, "localization": 3.0, "physics": 5.0}
"""Of a killed service, on a quiet machine; of the others 5 s."""
DRIVES_BY: Final = frozenset({"navigation", "localization", "mapping", "physics", "router"})
"""Without one of these the robot must stand."""


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong."""

    kind: Kind
    services: tuple[str, ...]
    hold_s: float = 0.0
    """How long it lasts; a kill is over at once."""
    needs_containers: bool = False

    @property
    def name(self) -> str:
        """As on the command line."""
        held = f"-{self.hold_s:g}s" if self.hold_s else ""
        return f"{self.kind}-{'+'.join(self.services) or 'all'}{held}"

    @property
    def ends_all(self) -> bool:
        """Whether nobody is left who knows the world."""
        return self.kind in ("restart", "late")

    @property
    def stops(self) -> bool:
        """Whether the robot must stand."""
        if self.kind in ("delay", "slow", "starve", *MACHINES):
            return False
        return self.ends_all or not DRIVES_BY.isdisjoint(self.services)

    @property
    def kills(self) -> bool:
        """Whether the services' processes end, and are started again."""
        return self.kind in ("kill", "squeeze")

    @property
    def back_s(self) -> float | None:
        """Within this time after it the services must be back; None: they were not gone."""
        if not self.kills or len(self.services) != 1:
            return None
        return _BACK_S.get(self.services[0], 5.0)

    def begin(self, stack: Stack) -> None:
        """Do it."""
        acts: dict[Kind, Callable[[str], None]] = {
            "kill": stack.kill, "freeze": stack.freeze, "cut": stack.cut,
            "restart": lambda _: stack.restart(), "starve": stack.starve, "late": stack.hold_back,
            "squeeze": stack.squeeze,
            **{kind: partial(stack.alter, machine=machine) for kind, machine in MACHINES.items()},
            **{kind: partial(stack.shape, shape=shape) for kind, shape in SHAPES.items()},
        }  # fmt: skip
        for service in self.services or (_ALL,):
            acts[self.kind](service)

    def end(self, stack: Stack) -> None:
        """Undo it."""
        acts: dict[Kind, Callable[[str], None]] = {
            "freeze": stack.thaw, "cut": stack.join, "starve": stack.feed, "late": stack.release,
            **dict.fromkeys(MACHINES, stack.restore), **dict.fromkeys(SHAPES, stack.unshape),
        }  # fmt: skip
        if self.kind in acts:
            for service in self.services or (_ALL,):
                acts[self.kind](service)


FAULTS: Final[tuple[Fault, ...]] = (
    *(Fault("kill", (service,)) for service in (*SERVICES, "router")),
    *(
        Fault("freeze", (service,), hold_s)
        for service, hold_s in (
            ("navigation", 3.0), ("localization", 3.0), ("physics", 3.0), ("perception", 10.0),
            ("recorder", 10.0), ("navigation", 10.0), ("router", 3.0), ("physics", 30.0),
        )
    ),
    Fault("kill", ("physics", "navigation")),
    Fault("kill", ("localization", "navigation")),
    Fault("kill", ("router", "recorder")),
    *(
        Fault("cut", (service,), hold_s, needs_containers=True)
        for service, hold_s in (
            ("navigation", 5.0), ("localization", 5.0), ("router", 5.0), ("navigation", 60.0),
        )
    ),
    *(
        Fault("starve", (service,), 10.0, needs_containers=True)
        for service in ("navigation", "localization", "physics", "router")
    ),
    *(
        Fault("squeeze", (service,), needs_containers=True)
        for service in ("navigation", "localization", "physics", "recorder")
    ),
    Fault("clock", (), 20.0),
    *(
        Fault("clock", (service,), 20.0, needs_containers=True)
        for service in ("navigation", "localization", "physics", "recorder", "router")
    ),
    Fault("disk", (), 20.0),
    Fault("disk", ("recorder",), 20.0, needs_containers=True),
    Fault("late", ("router",), 5.0, needs_containers=True),
    Fault("restart", ()),
)  # fmt: skip
EXPLORING_FAULTS: Final[tuple[Fault, ...]] = (
    *(Fault("kill", (service,)) for service in (*EXPLORING, "router")),
    Fault("kill", ("mapping", "explorer")),
    Fault("kill", ("physics", "mapping")),
    Fault("freeze", ("mapping",), 3.0),
    Fault("freeze", ("explorer",), 3.0),
)
"""While the robot makes its map."""
LINK_FAULTS: Final[tuple[Fault, ...]] = (
    *(
        Fault("half-open", (service,), 10.0)
        for service in ("navigation", "localization", "physics", "perception", "recorder")
    ),
    Fault("half-open", (), 5.0),
    Fault("delay", (), 20.0),
    Fault("slow", ("perception",), 20.0),
    Fault("slow", ("recorder",), 20.0),
)
"""Where a proxy is between the services and their router."""
SHORT: Final = ("kill-navigation", "kill-physics", "kill-localization", "kill-router")
