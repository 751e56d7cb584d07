"""`mazebot map build`: a map from a recorded log."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mazebot.cli.drive.progress import ProgressLine
from mazebot.cli.logs.log import Log, Topics
from mazebot.cli.logs.options import (
    AngleIncrement,
    AngleMin,
    Lidar,
    LogFile,
    OdomScale,
    OdomTopic,
    RangeMax,
    RangeMin,
    ScanTopic,
    check_odom_scale,
    scan_form,
    warn_of_guess,
    warn_of_odometry,
    warn_of_place,
)
from mazebot.cli.logs.read import read_log
from mazebot.cli.logs.scale import check_scale
from mazebot.cli.logs.turned import check_turn
from mazebot.cli.map.build_run import reasons, run
from mazebot.cli.map.relations import RelationErrors, read_relations, relation_errors
from mazebot.cli.parsing.options import Json, print_json
from mazebot.cli.parsing.outputs import refuse_inputs
from mazebot.cli.parsing.patience import say_first
from mazebot.cli.parsing.poses import given_pose
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2

if TYPE_CHECKING:
    from mazebot.cli.map.build_run import Built
    from mazebot.mapping.params import SlamParams

MAP, GRAPH = "map", "pose_graph.json"
TRAJECTORY, TRAJECTORY_TUM = "trajectory.csv", "trajectory.tum"
_FILES = (f"{MAP}.pgm", f"{MAP}.yaml", GRAPH, TRAJECTORY, TRAJECTORY_TUM)
_JUMPS_SHOWN = 5
_MOST_TURN_DISAGREEMENT = 0.6
"""Of good logs: 0.01 to 0.3; of beams in the wrong sense: 1.1 to 2."""
_MOST_CONTRADICTED = 0.2
"""Of the share that fits. Of a SICK's logs, also with few beams or a fifth of the range: at most
0.19 where walls are right within 0.2 m; where they stand twice, 0.21 to 1.4.
"""
_MANY_CARRIED_OFF = 0.2
"""Of the scans: a robot that is carried off finds itself where it has been."""
_HALF = 50
"""Per cent: cells above are rather occupied than free."""
_LEAST_FIT, _GOOD_FIT = 0.5, 0.7
"""Of the median scan: of a SICK's logs with a scan each metre, 0.87 to 0.97; with wrong directions
of the beams, 0.1 to 0.5.
"""


def build(
    log_file: LogFile = None,
    out: Annotated[
        Path | None,
        typer.Option(help="folder for map.yaml, map.pgm, pose_graph.json and the trajectory"),
    ] = None,
    draw: Annotated[
        Path | None, typer.Option(help="a PNG of the map, the trajectory and the loops")
    ] = None,
    relations: Annotated[
        Path | None,
        typer.Option(
            help="known relations of poses, timestamp1 timestamp2 x y z roll pitch yaw: print the "
            "trajectory's error against them"
        ),
    ] = None,
    params: Annotated[
        Path | None,
        typer.Option(help="YAML: parameters of mapping, or a file of slam_toolbox"),
    ] = None,
    lidar: Lidar = None,
    angle_min: AngleMin = None,
    angle_increment: AngleIncrement = None,
    range_min: RangeMin = None,
    range_max: RangeMax = None,
    scan_topic: ScanTopic = "/scan",
    odom_topic: OdomTopic = "/odom",
    odom_scale: OdomScale = 1.0,
    as_json: Json = False,
) -> None:
    """Build a map from a recorded log, as mapping does on the robot, and print figures of it."""
    if log_file is None or out is None:
        missing = "--log" if log_file is None else "--out"
        raise ConfigError(f"{missing}: must be given")
    check_odom_scale(odom_scale)
    form = scan_form(angle_min, angle_increment, range_min, range_max)
    base_from_scan = None if lidar is None else SE2(*given_pose("--lidar", lidar))
    _check_folder(out)
    if draw is not None and not draw.parent.is_dir():
        raise ConfigError(f"--draw: {draw}: {draw.parent} is not a folder")
    if draw is not None and draw.resolve() in {(out / name).resolve() for name in _FILES}:
        raise ConfigError(f"--draw: {draw}: is written by --out: must be another file")
    known = None if relations is None else read_relations(relations)
    slam_params = _params(params)
    say_first(f"reading {log_file}", as_json)
    log = read_log(log_file, form, Topics(scan_topic, odom_topic), odom_scale)
    warn_of_guess(log_file, log)
    warn_of_odometry(log_file, log)
    refuse_inputs("--out", (out / name for name in _FILES))
    if draw is not None:
        refuse_inputs("--draw", (draw,))
    if base_from_scan is None:
        warn_of_place(log_file, log)
    if log.no_returns:
        raise ConfigError(f"--log: {log_file}: {log.no_returns}: --range-min, --range-max set them")
    check_scale(log_file, log, base_from_scan, odom_scale)
    check_turn(log_file, log, base_from_scan)
    try:
        with ProgressLine(wanted=not as_json) as progress:
            built = run(
                log, slam_params, base_from_scan,
                lambda done, scans, slam: progress.show(
                    f"{done} of {scans} scans, {slam.keyframes} keyframes, {slam.loops} loops"
                ),
            )  # fmt: skip
    except ConfigError as error:
        raise ConfigError(f"--log: {log_file}: {error}") from error
    # First, for it may be why scans could not be used.
    warn_of_fit(log_file, built)
    _check_used(log_file, built)
    errors = None
    if known is not None:
        errors = relation_errors(built.times_s, built.poses, known, built.odometry)
    files = _write(out, built)
    if draw is not None:
        from mazebot.cli.map.build_drawing import draw_built  # noqa: PLC0415 - loads OpenCV

        draw_built(draw, built)
    figures = {
        **built.figures(),
        "scans_retimed": log.retimed,
        "lines_left_out": log.skipped,
        "remarks": log.remarks(),
    }
    if errors is not None:
        figures["relations"] = errors.document()
    if as_json:
        print_json({**figures, "files": [str(file) for file in files]})
    else:
        sys.stdout.write("".join(f"{line}\n" for line in _lines(log, figures, errors, files)))


def _params(path: Path | None) -> SlamParams:
    from mazebot.cli.map.slam_params import read_slam_params  # noqa: PLC0415
    from mazebot.mapping.params import SlamParams  # noqa: PLC0415

    if path is None:
        return SlamParams()
    read, others = read_slam_params(path)
    if others:
        sys.stderr.write(f"{path}: not used: {', '.join(others)}\n")
    return read


def _check_folder(out: Path) -> None:
    """Raises ConfigError where no files can be written: before the work, not after it."""
    there = next(folder for folder in (out.absolute(), *out.absolute().parents) if folder.exists())
    if not there.is_dir():
        raise ConfigError(f"--out: {out}: must be a folder, or a new folder in an existing one")
    if not os.access(there, os.W_OK):
        raise ConfigError(f"--out: {out}: cannot be written: Permission denied")


def _check_used(log_file: Path, built: Built) -> None:
    """Raises ConfigError where most scans could not be used, contradict odometry, or show no wall:
    a map of a small part of a log is not the map that was asked for.
    """
    used, wanted = _used(built)
    if 2 * used < wanted:
        raise ConfigError(
            f"--log: {log_file}: {used} of {wanted} scans could be used, "
            f"{reasons(built.slam.left_out)}: must be at least half of them"
        )
    jumps = len(built.slam.jumps)
    if 2 * jumps > used:
        raise ConfigError(
            f"--log: {log_file}: the scans contradict odometry at {jumps} of {used} scans, where "
            "it moves by more than 1 m: must be metres and radians: --odom-scale sets the former"
        )
    if not (built.slam.grid().cells > _HALF).any():
        raise ConfigError(
            f"--log: {log_file}: no cell of its map is occupied: too few ranges are >= range_min, "
            "< range_max and < max_laser_range: --range-min, --range-max and --params set them"
        )


def warn_of_fit(log_file: Path, built: Built) -> None:
    """Say where the scans fit neither each other nor odometry: what they make is hardly a map."""
    from mazebot.mapping.slam import CARRIED_OFF  # noqa: PLC0415 - loads Numba

    _, wanted = _used(built)
    carried_off = built.slam.left_out[CARRIED_OFF]
    most_contradicted = _MOST_CONTRADICTED * built.fit_median
    for is_wrong, what, check in (
        (
            built.fit_median < _LEAST_FIT,
            f"the scans do not fit each other: {100.0 * built.fit_median:.0f} % of a scan's "
            "returns lie where those before saw walls, by the median: should be "
            f"{100.0 * _LEAST_FIT:.0f} % or more",
            "--angle-min, --angle-increment and --lidar",
        ),
        (
            built.fit_median >= _LEAST_FIT and built.contradicted > most_contradicted,
            f"the map contradicts itself: {100.0 * built.contradicted:.0f} % of what a keyframe "
            "saw stands on floor that others saw or behind their walls, by the median: should be "
            f"{100.0 * most_contradicted:.0f} % or less",
            "the picture of --draw, --angle-increment and --lidar; scans closer together, or of "
            "more beams, help",
        ),
        (
            built.turn_disagreement > _MOST_TURN_DISAGREEMENT,
            f"the scans do not turn as odometry does: by {100.0 * built.turn_disagreement:.0f} % "
            f"of its turns otherwise: should be {100.0 * _MOST_TURN_DISAGREEMENT:.0f} % or less",
            "whether --angle-increment has the right sign, the lidar hangs upside down, and "
            "odometry's yaw is in radians",
        ),
        (
            carried_off > _MANY_CARRIED_OFF * wanted,
            f"{carried_off} of {wanted} scans were left out, {CARRIED_OFF}",
            "--angle-min, --angle-increment and --lidar",
        ),
    ):
        if is_wrong:
            sys.stderr.write(f"warning: --log: {log_file}: {what}: check {check}\n")


def _used(built: Built) -> tuple[int, int]:
    """How many scans were used, and how many should be."""
    from mazebot.mapping.slam import TOO_SOON  # noqa: PLC0415 - loads Numba

    return len(built.times_s), built.scans - built.slam.left_out[TOO_SOON]


def _write(out: Path, built: Built) -> list[Path]:
    from mazebot.common.files.folder_writing import write_file  # noqa: PLC0415
    from mazebot.common.world.map_files import write_map  # noqa: PLC0415

    grid = built.slam.grid()
    written = write_map(out, MAP, grid.cells, grid.resolution_m, grid.origin)
    texts = {
        GRAPH: built.graph.model_dump_json(),
        TRAJECTORY: built.trajectory_csv(),
        TRAJECTORY_TUM: built.trajectory_tum(),
    }
    try:
        for name, text in texts.items():
            write_file(out / name, text.encode())
    except OSError as error:
        raise ConfigError(f"--out: {out}: cannot be written: {error.strerror}") from error
    return [written, written.with_suffix(".pgm"), *(out / name for name in texts)]


def _remarks(log: Log, figures: dict[str, Any]) -> list[tuple[str, str]]:
    """What of the log was not used, or not as it is."""
    rows = []
    if why := reasons(figures["left_out_reasons"]):
        rows.append(("left out", f"scans: {why}"))
    if figures["lines_left_out"]:
        rows.append(("left out", "the last line, which is cut off"))
    rows += [("times", remark) for remark in log.remarks()]
    jumps = figures["odometry_jumps"]
    for jump in jumps[:_JUMPS_SHOWN]:
        rows.append(
            ("jump", f"odometry by {jump['moved_m']:.2f} m and {jump['turned_rad']:.2f} rad, "
             f"{jump['from_s']:.3f} to {jump['to_s']:.3f} s: the scans contradict it")
        )  # fmt: skip
    if len(jumps) > _JUMPS_SHOWN:
        rows.append(("jump", f"and {len(jumps) - _JUMPS_SHOWN} more"))
    return rows


def _lines(
    log: Log, figures: dict[str, Any], errors: RelationErrors | None, files: list[Path]
) -> list[str]:
    scan_ms, size = figures["scan_ms"], figures["map"]
    rows = [
        ("log", f"{figures['scans']} scans in {figures['log_s']:.0f} s, "
         f"{figures['driven_m']:.0f} m by odometry"),
        *_remarks(log, figures),
        ("map", f"{size['columns']} x {size['rows']} cells of {size['resolution_m']:g} m, "
         f"{size['known_m2']:.0f} m2 known"),
        ("fit", f"{100.0 * figures['fit_median']:.0f} % of a scan's returns lie where those before "
         "saw walls, by the median" + ": little" * (figures["fit_median"] < _GOOD_FIT)),
        ("keyframes", f"{figures['keyframes']}"),
        ("loops", f"{figures['loops']} closed, {figures['loops_rejected']} rejected"),
        *((f"{kind} edges", f"{edges['count']}, mean chi2 {edges['mean_chi2']:.3f}")
          for kind, edges in figures["edges"].items()),
        ("time per scan", f"median {scan_ms['median']:.2f} ms, p99 {scan_ms['p99']:.1f}, "
         f"longest {scan_ms['max']:.0f}"),
        ("time", f"{figures['elapsed_s']:.1f} s, {figures['times_real']:.0f} times as fast as "
         "the log"),
    ]  # fmt: skip
    if errors is not None:
        (m, m_std), (deg, deg_std) = errors.translation_m, errors.rotation_deg
        (m2, m2_std), (deg2, deg2_std) = errors.translation_squared_m2, errors.rotation_squared_deg2
        rows += [
            ("relations", f"{errors.used} used, {errors.left_out} outside of the log"
             + f", {errors.between} between scans, by odometry" * bool(errors.between)),
            ("translation", f"{m:.4f} +- {m_std:.4f} m, squared {m2:.5f} +- {m2_std:.5f} m2"),
            ("rotation", f"{deg:.3f} +- {deg_std:.3f} deg, "
             f"squared {deg2:.3f} +- {deg2_std:.3f} deg2"),
        ]  # fmt: skip
    rows += [("file" if i else "files", str(file)) for i, file in enumerate(files)]
    width = max(len(name) for name, _ in rows) + 2
    return [f"{name if name != 'file' else '':{width}}{text}" for name, text in rows]
