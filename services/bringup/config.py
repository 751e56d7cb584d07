"""What `bringup` is told."""

from __future__ import annotations

import json
import re
from typing import Annotated

from pydantic import BeforeValidator, Field

from services.common.config import PlainText, ServiceConfig
from services.common.node.documents import Finite


def _listed(value: object) -> object:
    """A text as the list it stands for: JSON, or `field=value` with commas between."""
    if not isinstance(value, str):
        return value
    if value.lstrip().startswith("["):
        try:
            return json.loads(value)
        except ValueError as error:
            raise ValueError("must be `field=value`, or a JSON list of them") from error
    # Only where a field begins: a value such as {x_m: 1, y_m: 2} has commas of its own.
    return re.split(r",(?=\s*[A-Za-z_][\w.]*=)", value) if value.strip() else ()


class BringupConfig(ServiceConfig):
    """Which world to ask for, and where to drive in it."""

    world_name: str = Field("sim_house_enhanced", description="the world to ask for")
    use_aruco: bool = Field(True, description="keep the world's ArUco markers")
    # A flag given twice arrives as one text, with a comma between.
    world_overrides: Annotated[tuple[str, ...], PlainText, BeforeValidator(_listed)] = Field(
        (),
        description="put over the world's recipe: `maze.seed=3`; more after commas or as JSON",
    )
    tour: tuple[str, ...] = Field(
        (),
        description="names of locations to drive to, in order; `home` is the robot's start; none: "
        "all of the world's, or places spread over its floor where it has none, then `home`",
    )
    goal: tuple[Finite, Finite, Finite] | None = Field(
        None, description="x (m), y (m), yaw (rad) in the map frame: one goal in place of the tour"
    )
    bringup_timeout_s: float = Field(
        60.0, gt=0, description="simulation time after which a stack that is not active has failed"
    )
    resend_after_s: float = Field(
        2.0, gt=0, description="simulation time without a sign of the goal; then it is sent again"
    )
    only_ask: bool = Field(
        False, description="end with the answer to the request: an error where another world runs"
    )
