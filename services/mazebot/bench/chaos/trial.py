"""What one fault has done."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass
class Trial:
    """What one fault has done."""

    fault: str
    number: int
    stop_s: float | None = None
    """From the fault to rest, where the robot had to stand and could be seen."""
    stop_m: float | None = None
    back_s: float | None = None
    """From the fault, or its end, until the services were there again."""
    drives_s: float | None = None
    """Until the robot could be sent about again."""
    contacts: int = 0
    goal: str = ""
    """How the goal, or the exploration, ended during which it happened."""
    next_goal: str = ""
    """And the one after it; of an exploration, the drive after it."""
    seen_m2: float = 0.0
    """Floor that an exploration had seen before."""
    same_world: bool = True
    """Whether world, pose and time went on."""
    problem: str = ""
    """Why it has not recovered; empty: it has."""

    @property
    def recovered(self) -> bool:
        """Whether the robot drives again, all goals were answered, and the next was reached."""
        return not self.problem and bool(self.goal) and self.next_goal == "reached"

    def values(self) -> dict[str, object]:
        """For the report."""
        return asdict(self) | {"recovered": self.recovered}
