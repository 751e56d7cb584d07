"""`mazebot plan`: a path on any map of Nav2."""

from __future__ import annotations

import io
import math
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import numpy as np
import typer

from mazebot.cli.parsing.options import Json, print_json
from mazebot.cli.parsing.outputs import refuse_inputs
from mazebot.cli.parsing.poses import POSE, given_pose
from mazebot.common.config import ConfigError
from mazebot.common.files.folder_writing import write_file

if TYPE_CHECKING:
    from mazebot.common.maths.frames import SE2
    from mazebot.navigation.costmap.costmap import Costmap, GridFrame
    from mazebot.navigation.costmap.footprint import Footprint
    from mazebot.navigation.costmap.zones import Zones
    from mazebot.navigation.errors import NavigationError
    from mazebot.navigation.mask_files import Masks
    from mazebot.navigation.planning.interface import GlobalPlanner, PlannerParams
    from mazebot.navigation.planning.path import PlannedPath

NOT_PLANNED = 1
"""Exit code if there is no path: the text begins with Nav2's number of the error."""
_MAX_SIDE_CELLS = 20_000
_SMALLEST_PICTURE_PX = 900


def plan(
    map_file: Annotated[
        Path, typer.Option("--map", metavar="MAP.yaml", help="a map as Nav2's map_server reads it")
    ],
    start: Annotated[str, typer.Option(metavar=POSE, help="in the map, m and rad; also X,Y,YAW")],
    goal: Annotated[str, typer.Option(metavar=POSE, help="in the map, m and rad; also X,Y,YAW")],
    radius: Annotated[
        float | None,
        typer.Option(min=0.0, max=100.0, help="m, radius of the robot [default: a waffle]"),
    ] = None,
    planner: Annotated[
        str,
        typer.Option(help="any_angle, a_star, or your own: my_package.my_module:Class, "
                          "FILE.py:Class"),
    ] = "any_angle",
    tolerance: Annotated[
        float, typer.Option(min=0.0, max=100.0, help="m, how far from the goal the path may end")
    ] = 0.0,
    inflation_radius: Annotated[
        float, typer.Option(min=0.0, max=100.0, help="m, cells nearer to an obstacle have a cost")
    ] = 0.7,
    cost_scaling_factor: Annotated[
        float, typer.Option(min=0.0, max=1e3, help="1/m, how fast that cost falls")
    ] = 10.0,
    cost_travel_multiplier: Annotated[
        float,
        typer.Option(min=0.0, max=100.0, help="weight of the cost; 0: the shortest path"),
    ] = 1.0,
    allow_unknown: Annotated[
        bool, typer.Option("--allow-unknown", help="allow paths through unknown cells")
    ] = False,
    allow_reverse: Annotated[
        bool, typer.Option("--allow-reverse", help="allow driving backwards where nothing "
                                                   "else is possible")
    ] = False,
    keepout: Annotated[
        Path | None,
        typer.Option(metavar="MASK.yaml", help="a keepout mask, as in Nav2"),
    ] = None,
    speed: Annotated[
        Path | None,
        typer.Option(metavar="MASK.yaml", help="a speed mask in percent, as in Nav2"),
    ] = None,
    draw: Annotated[
        Path | None, typer.Option(metavar="OUT.png", help="draw the map with the path")
    ] = None,
    as_json: Json = False,
) -> None:  # fmt: skip
    """Plan a path on a map: prints its length, the time taken and its poses.

    Where there is none, the exit code is 1, and the line begins with Nav2's number of the error.
    """
    from mazebot.common.maths.frames import SE2  # noqa: PLC0415
    from mazebot.navigation.errors import NavigationError  # noqa: PLC0415
    from mazebot.navigation.planners import make_planner  # noqa: PLC0415
    from mazebot.navigation.planning.interface import GridPlannerParams, PlannerParams  # noqa: PLC0415

    start_pose, goal_pose = SE2(*given_pose("--start", start)), SE2(*given_pose("--goal", goal))
    if draw is not None and draw.suffix.lower() != ".png":
        raise ConfigError(f"--draw: {draw}: must end in .png")
    masks = _masks(keepout, speed)
    costmap, footprint = _costmap(map_file, radius, inflation_radius, cost_scaling_factor)
    if draw is not None:
        refuse_inputs("--draw", (draw,))
    zones = _zones(costmap.frame, masks)
    params = PlannerParams(
        GridPlannerParams(cost_travel_multiplier=cost_travel_multiplier),
        path_spacing_m=costmap.frame.resolution_m,
        smoothing_iterations=100,
        allow_unknown=allow_unknown,
        footprint=footprint,
        allow_reverse=allow_reverse,
    )
    chosen = make_planner(planner, params)
    try:
        if zones is not None and zones.keepout.size:
            costmap = _with_zones(costmap, zones, params, start_pose, goal_pose)
        path, taken_s = _timed(chosen, costmap, zones, start_pose, goal_pose, tolerance)
    except NavigationError as error:
        if draw is not None:
            _draw(draw, costmap, start_pose, goal_pose, None, error)
        _fail(error, as_json)
    if draw is not None:
        _draw(draw, costmap, start_pose, goal_pose, path, None)
    _print_path(path, taken_s, planner, as_json, _slow(path, zones))


def _timed(
    planner: GlobalPlanner,
    costmap: Costmap,
    zones: Zones | None,
    start: SE2,
    goal: SE2,
    tolerance_m: float,
) -> tuple[PlannedPath, float]:
    """A path, and the wall time to plan it, s. Raises NavigationError."""
    from mazebot.navigation.planning.planner import Planner  # noqa: PLC0415

    if isinstance(planner, Planner):
        # The first time its kernels are loaded.
        planner.plan(costmap, start, goal, tolerance_m, zones=zones)
    start_s = time.perf_counter()
    path = planner.plan(costmap, start, goal, tolerance_m)
    return path, time.perf_counter() - start_s


def _costmap(
    map_file: Path, radius_m: float | None, inflation_radius_m: float, scaling: float
) -> tuple[Costmap, Footprint | None]:
    """The inflated map, and the footprint if the robot is not round."""
    from mazebot.common.world.costmap import OCCUPIED, straightened  # noqa: PLC0415
    from mazebot.common.world.map_files import read_map  # noqa: PLC0415
    from mazebot.navigation.costmap.footprint import WAFFLE  # noqa: PLC0415
    from mazebot.navigation.costmap.layered_costmap import (  # noqa: PLC0415
        InflationParams,
        frame_of,
        inflate,
    )

    loaded = read_map(map_file)
    if loaded.warning:
        sys.stderr.write(f"warning: {loaded.warning}\n")
    origin, cells = straightened(loaded.resolution_m, loaded.origin, loaded.cells)
    if max(cells.shape) > _MAX_SIDE_CELLS:
        raise ConfigError(f"--map: {map_file}: must have at most {_MAX_SIDE_CELLS} cells a side")
    footprint = WAFFLE if radius_m is None else None
    inscribed_m = WAFFLE.half_width_m if radius_m is None else radius_m
    inflation = InflationParams(
        custom_inscribed_radius=inscribed_m, inflation_radius=inflation_radius_m,
        cost_scaling_factor=scaling,
    )  # fmt: skip
    frame = frame_of(loaded.resolution_m, origin, cells)
    return inflate(frame, cells >= OCCUPIED, cells < 0, inflation), footprint


def _masks(keepout: Path | None, speed: Path | None) -> Masks:
    from mazebot.navigation.config import FilterInfoServerParams  # noqa: PLC0415
    from mazebot.navigation.mask_files import read_masks  # noqa: PLC0415

    return read_masks(
        ("--keepout", str(keepout or "")), ("--speed", str(speed or "")), FilterInfoServerParams()
    )


def _zones(frame: GridFrame, masks: Masks) -> Zones | None:
    from mazebot.navigation.control.controller import RobotLimits  # noqa: PLC0415
    from mazebot.navigation.costmap.zones import zones_of  # noqa: PLC0415

    highest_m_s = RobotLimits().max_linear_vel
    return zones_of(frame, highest_m_s, keepout_masks=masks.keepout, speed_masks=masks.speed)


def _with_zones(
    costmap: Costmap, zones: Zones, params: PlannerParams, start: SE2, goal: SE2
) -> Costmap:
    """The costmap with the keepout zones; that of the start can be left.

    Raises NavigationError with GOAL_OCCUPIED for a goal in one.
    """
    from mazebot.navigation.costmap.costmap import NO_INFORMATION  # noqa: PLC0415
    from mazebot.navigation.planning.ends import nearest_free_pose  # noqa: PLC0415
    from mazebot.navigation.planning.grid.search_grid import search_grid  # noqa: PLC0415
    from mazebot.navigation.robot.planner_server import forbidden_goal  # noqa: PLC0415

    def with_costs(leaving_m: tuple[float, float] | None) -> Costmap:
        costs = zones.costs(costmap.inscribed_radius_m, leaving_m)
        assert costs is not None
        # As where a costmap is composed: zones count in unknown cells too.
        stronger = (costs > 0) & ((costmap.costs == NO_INFORMATION) | (costs > costmap.costs))
        return replace(costmap, costs=np.where(stronger, costs, costmap.costs))

    zone = zones.keepout_at(*goal[:2])
    if zone is not None:
        kept_out, footprint = with_costs(None), params.footprint
        passing_m = costmap.inscribed_radius_m if footprint is None else footprint.half_width_m
        grid = search_grid(kept_out, passing_m, params.allow_unknown)
        near = nearest_free_pose(grid, kept_out, footprint, goal, math.inf)
        raise forbidden_goal(goal, zone, near)
    return with_costs(start[:2] if zones.keepout_at(*start[:2]) is not None else None)


def _slow(path: PlannedPath, zones: Zones | None) -> dict[float, float]:
    """By speed limit, m/s, the length of the path below it, in metres; the lowest limit first."""
    lengths: dict[float, float] = {}
    if zones is not None and zones.limits_m_s.size:
        steps_m = np.linalg.norm(np.diff(path.points_m, axis=0), axis=1)
        limits = zones.limits_at((path.points_m[:-1] + path.points_m[1:]) / 2.0)
        for limit_m_s, step_m in zip(limits.tolist(), steps_m.tolist(), strict=True):
            if limit_m_s < math.inf:
                lengths[limit_m_s] = lengths.get(limit_m_s, 0.0) + step_m
    return dict(sorted(lengths.items()))


def _print_path(
    path: PlannedPath, taken_s: float, planner: str, as_json: bool, slow: dict[float, float]
) -> None:
    poses = np.column_stack([path.points_m, path.yaws_rad])
    if as_json:
        print_json(
            {
                "error_code": 0,
                "planner": planner,
                "length_m": round(path.length_m, 4),
                "cost_m": round(path.cost_m, 4),
                "planning_time_s": round(taken_s, 6),
                "speed_limits": [
                    {"speed_limit_m_s": round(limit_m_s, 4), "length_m": round(length_m, 4)}
                    for limit_m_s, length_m in slow.items()
                ],
                "poses": [[round(float(value), 4) for value in pose] for pose in poses],
            }
        )
        return
    sys.stdout.write(
        f"length {path.length_m:.2f} m, cost {path.cost_m:.2f} m, {len(poses)} poses, "
        f"planned in {taken_s * 1e3:.1f} ms by {planner}\n"
    )
    for limit_m_s, length_m in slow.items():
        sys.stdout.write(f"at most {limit_m_s:.3g} m/s over {length_m:.2f} m\n")
    for x_m, y_m, yaw_rad in poses:
        sys.stdout.write(f"{x_m:.3f} {y_m:.3f} {yaw_rad:.3f}\n")


def _fail(error: NavigationError, as_json: bool) -> NoReturn:
    if as_json:
        answer: dict[str, Any] = {
            "error_code": int(error.code),
            "error": error.code.name,
            "error_msg": error.message,
            "place": None if error.place_m is None else list(error.place_m),
            "nearest_free": None if error.nearest_free is None else list(error.nearest_free),
        }
        print_json(answer)
    else:
        sys.stderr.write(f"error: {int(error.code)} {error.code.name}: {error.message}\n")
    raise typer.Exit(NOT_PLANNED)


def _draw(
    file: Path, costmap: Costmap, start: SE2, goal: SE2, path: PlannedPath | None,
    error: NavigationError | None,
) -> None:  # fmt: skip
    """The costmap with the path, or with what is in its way."""
    from PIL import Image, ImageDraw  # noqa: PLC0415

    frame = costmap.frame
    # Costs from white to grey, too near to obstacles blue, obstacles black, unknown brown.
    colours = np.empty((256, 3), np.uint8)
    colours[:] = (255 - np.minimum(np.arange(256), 252) // 4)[:, None]
    colours[253], colours[254], colours[255] = (150, 175, 215), (30, 30, 30), (200, 190, 170)
    scale = max(1, -(-_SMALLEST_PICTURE_PX // max(frame.rows, frame.columns)))
    picture = Image.fromarray(colours[costmap.costs[::-1]]).resize(
        (frame.columns * scale, frame.rows * scale), Image.Resampling.NEAREST
    )
    drawing = ImageDraw.Draw(picture)

    def pixel(x_m: float, y_m: float) -> tuple[float, float]:
        across = (x_m - frame.origin_x_m) / frame.resolution_m * scale
        return across, (frame.rows - (y_m - frame.origin_y_m) / frame.resolution_m) * scale

    def dot(x_m: float, y_m: float, colour: str) -> None:
        x, y = pixel(x_m, y_m)
        reach = max(5, 2 * scale)
        drawing.ellipse((x - reach, y - reach, x + reach, y + reach), fill=colour, outline="white")

    if path is not None:
        drawing.line([pixel(*point) for point in path.points_m.tolist()], "red", max(2, scale))
    dot(start.x_m, start.y_m, "green")
    dot(goal.x_m, goal.y_m, "blue")
    if error is not None and error.place_m is not None:
        dot(*error.place_m, "red")
    if error is not None and error.nearest_free is not None:
        dot(error.nearest_free.x_m, error.nearest_free.y_m, "orange")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        data = io.BytesIO()
        picture.save(data, "PNG")
        write_file(file, data.getvalue())
    except OSError as problem:
        raise ConfigError(f"--draw: {file}: cannot be written: {problem.strerror}") from problem
