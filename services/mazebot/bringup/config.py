"""The configuration of `bringup`."""

from __future__ import annotations

import json
import re
from typing import Annotated

from pydantic import BeforeValidator, Field

from mazebot.common.config import PlainText, ServiceConfig
from mazebot.common.messages.documents import Finite


def _listed(value: object) -> object:
    """The list given as text: JSON, or `field=value` separated by commas."""
    if not isinstance(value, str):
        return value
    if value.lstrip().startswith("["):
        try:
            return json.loads(value)
        except ValueError as error:
            raise ValueError("must be `field=value`, or a JSON list of them") from error
    # Split only where a field begins: a value such as {x_m: 1, y_m: 2} contains commas.
    return re.split(r",(?=\s*[A-Za-z_][\w.]*=)", value) if value.strip() else ()


class BringupConfig(ServiceConfig):
    """The world to request, and the goals in it."""

    world_name: str = Field("sim_house_enhanced", description="the world to request")
    use_aruco: bool = Field(True, description="keep the world's ArUco markers")
    # A flag given twice is passed as one text, separated by a comma.
    world_overrides: Annotated[tuple[str, ...], PlainText, BeforeValidator(_listed)] = Field(
        (),
        description="overrides the world's recipe: `maze.seed=3`; several with commas or as JSON",
    )
    slam: bool = Field(
        False, description="the robot gets no map: mapping makes one, and localises the robot in it"
    )
    explore: bool = Field(
        True,
        description="with slam: the explorer drives; false: only `goal`, or goals sent by a client",
    )
    tour: tuple[str, ...] = Field(
        (),
        description="names of the locations to drive to, in order; `home` is the robot's start; "
        "none: all of the world's, or poses spread over its floor if it has none, then `home`",
    )
    goal: tuple[Finite, Finite, Finite] | None = Field(
        None, description="x (m), y (m), yaw (rad) in the map frame: one goal instead of the tour"
    )
    bringup_timeout_s: float = Field(
        60.0, gt=0, description="simulation time within which the stack must become active"
    )
    resend_after_s: float = Field(
        2.0,
        gt=0,
        description="simulation time after which a goal is resent that navigation lost, or that "
        "gave way to a new goal, when that has ended",
    )
    drive: bool = Field(
        True, description="drive the tour; false: end when the world runs, for others to drive in"
    )
    only_ask: bool = Field(
        False,
        description="exit after the reply to the request: an error if another world is running",
    )
