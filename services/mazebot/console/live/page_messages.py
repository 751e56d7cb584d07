"""What a page may ask for."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, TypeAdapter, ValidationError

from mazebot.common.config import one_line
from mazebot.common.messages import documents as doc
from mazebot.common.robot.waffle import MAX_ANGULAR_RAD_S, MAX_LINEAR_M_S

MAX_MESSAGE_CHARACTERS = 16_384
MAX_WAYPOINTS = 100

Coordinate = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Angle = Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False)]
Side = Annotated[float, Field(gt=0.0, le=10.0, allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1, max_length=200)]


class Place(doc.Document):
    """A pose in the map."""

    x_m: Coordinate
    y_m: Coordinate
    yaw_rad: Angle = 0.0

    def planar(self) -> doc.Planar:
        """The same as a message."""
        return doc.Planar(x_m=self.x_m, y_m=self.y_m, yaw_rad=self.yaw_rad)


class Destination(doc.Document):
    """Where to drive."""

    x_m: Coordinate
    y_m: Coordinate
    yaw_rad: Angle | None = Field(None, description="null: as the robot arrives")


class Goal(doc.Document):
    """Drive to a pose."""

    do: Literal["goal"]
    pose: Destination


class InitialPose(doc.Document):
    """Set where the robot is."""

    do: Literal["initial_pose"]
    pose: Place


class Waypoints(doc.Document):
    """Drive to poses one after the other."""

    do: Literal["waypoints"]
    poses: Annotated[tuple[Destination, ...], Field(min_length=1, max_length=MAX_WAYPOINTS)]
    stops: bool = Field(True, description="stop at each, or drive through to the last one")


class DropBox(doc.Document):
    """Put a box on the floor."""

    do: Literal["drop_box"]
    pose: Place
    size_m: tuple[Side, Side, Side] = (0.3, 0.3, 0.3)
    mass_kg: Annotated[float, Field(ge=0.0, le=1000.0, allow_inf_nan=False)] = 0.0


class Remove(doc.Document):
    """Remove an entity."""

    do: Literal["remove"]
    name: Name


class Dock(doc.Document):
    """Dock at a marker."""

    do: Literal["dock"]
    dock_id: Name


class Undock(doc.Document):
    """Leave the dock."""

    do: Literal["undock"]


class Spin(doc.Document):
    """Turn on the spot."""

    do: Literal["spin"]
    angle_rad: Annotated[float, Field(ge=-20.0, le=20.0, allow_inf_nan=False)] = 1.57


class BackUp(doc.Document):
    """Drive straight back."""

    do: Literal["back_up"]
    distance_m: Annotated[float, Field(gt=0.0, le=5.0, allow_inf_nan=False)] = 0.15


class Cancel(doc.Document):
    """Cancel what the robot does."""

    do: Literal["cancel"]


class PauseTask(doc.Document):
    """Pause or resume what the robot does."""

    do: Literal["pause_task"]
    pause: bool


class ClearCostmaps(doc.Document):
    """Forget obstacles that are not seen now."""

    do: Literal["clear_costmaps"]


class FindRobot(doc.Document):
    """Search the robot on the whole map."""

    do: Literal["global_localization"]


class Explore(doc.Document):
    """Let the exploration go on, or stop."""

    do: Literal["explore"]
    resume: bool


class Simulation(doc.Document):
    """Pause, resume, step, reset, change the speed."""

    do: Literal["simulation"]
    pause: bool | None = None
    step: Annotated[int, Field(ge=1, le=2400)] | None = None
    reset: Literal["all", "time"] | None = None
    speed: doc.Speed | None = None


class Drive(doc.Document):
    """The velocity that the user commands, to be sent repeatedly while it is wanted."""

    do: Literal["drive"]
    linear_m_s: Annotated[float, Field(ge=-MAX_LINEAR_M_S, le=MAX_LINEAR_M_S, allow_inf_nan=False)]
    angular_rad_s: Annotated[
        float, Field(ge=-MAX_ANGULAR_RAD_S, le=MAX_ANGULAR_RAD_S, allow_inf_nan=False)
    ]


class EmergencyStop(doc.Document):
    """Stop the robot and hold it at rest, or let it move again."""

    do: Literal["emergency_stop"]
    stop: bool


class Stop(doc.Document):
    """No velocity is wanted any more."""

    do: Literal["stop"]


class Show(doc.Document):
    """What this page wants to be sent."""

    do: Literal["show"]
    camera: bool


Action = Annotated[
    Goal | InitialPose | Waypoints | DropBox | Remove | Dock | Undock | Spin | BackUp | Cancel
    | PauseTask | EmergencyStop | ClearCostmaps | FindRobot | Explore | Simulation | Drive | Stop
    | Show,
    Field(discriminator="do"),
]  # fmt: skip


class PageMessage(doc.Document):
    """A message of the page; its answer has the same id."""

    id: Annotated[int, Field(ge=0, le=2**53)]
    action: Action


class RefusedError(Exception):
    """What the page asked for was refused; the text is one line, in the service's words."""


_MESSAGE: TypeAdapter[PageMessage] = TypeAdapter(PageMessage)


def read_message(text: str) -> PageMessage:
    """Raises RefusedError, in one line, where the text is no message of the page."""
    if len(text) > MAX_MESSAGE_CHARACTERS:
        raise RefusedError(
            f"message: {len(text)} characters: must be at most {MAX_MESSAGE_CHARACTERS}"
        )
    try:
        return _MESSAGE.validate_json(text)
    except ValidationError as error:
        raise RefusedError(f"message: {one_line(error)}"[:300]) from error
