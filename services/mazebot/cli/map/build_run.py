"""Mapping on a log: all scans through `Slam`, the final pose of each, and figures."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mazebot.cli.logs.log import Log
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2, Array, wrap_angles

if TYPE_CHECKING:
    from mazebot.common.messages.slam_documents import PoseGraph
    from mazebot.mapping.params import SlamParams
    from mazebot.mapping.slam import Slam

_PROGRESS_EVERY = 50
_LEAST_TURNED_RAD = math.pi


@dataclass(frozen=True)
class Built:
    """A map made of a log."""

    slam: Slam
    graph: PoseGraph
    times_s: Array
    """(n,) of the scans that were used."""
    poses: Array
    """(n, 3) map_from_base at these times, by the graph as it is at the end."""
    scans: int
    """Scans in the log."""
    fits: Array
    """(n,) share of the returns that the scans before had seen as well."""
    step_ms: Array
    """(m,) time that each scan took."""
    elapsed_s: float
    driven_m: float
    """By odometry."""
    odometry: Array
    """(k, 4) time and odom_from_base of the log."""
    contradicted: float
    """Share of a keyframe's returns on floor that others saw, or behind their walls: the median."""

    @property
    def log_s(self) -> float:
        """The log's own time."""
        return float(self.times_s[-1] - self.times_s[0])

    @property
    def fit_median(self) -> float:
        """Of the shares of the returns that fit."""
        return float(np.median(self.fits))

    @property
    def turn_disagreement(self) -> float:
        """By how much the scans turn otherwise than odometry."""
        return turn_disagreement(self.times_s, self.poses, self.odometry)

    def trajectory_csv(self) -> str:
        """time_s, x_m, y_m, yaw_rad of each scan."""
        rows = zip(self.times_s.tolist(), self.poses.tolist(), strict=True)
        lines = [f"{t:.6f},{x:.6f},{y:.6f},{yaw:.6f}" for t, (x, y, yaw) in rows]
        return "\n".join(["time_s,x_m,y_m,yaw_rad", *lines]) + "\n"

    def trajectory_tum(self) -> str:
        """The same as the TUM benchmark has it: time, position, orientation as a quaternion."""
        lines = []
        for t, (x, y, yaw) in zip(self.times_s.tolist(), self.poses.tolist(), strict=True):
            qz, qw = math.sin(yaw / 2.0), math.cos(yaw / 2.0)
            lines.append(f"{t:.6f} {x:.6f} {y:.6f} 0 0 0 {qz:.9f} {qw:.9f}\n")
        return "".join(lines)

    def figures(self) -> dict[str, Any]:
        """What there is to say of it, for JSON."""
        grid = self.slam.grid()
        rows, columns = grid.cells.shape
        edges: dict[str, list[float]] = {}
        for edge in self.graph.edges:
            edges.setdefault(edge.kind, []).append(edge.residual)
        return {
            "scans": self.scans,
            "scans_used": len(self.times_s),
            "scans_left_out": sum(self.slam.left_out.values()),
            "left_out_reasons": dict(self.slam.left_out),
            "odometry_jumps": [
                {
                    "from_s": jump.from_ns * 1e-9,
                    "to_s": jump.to_ns * 1e-9,
                    "moved_m": round(math.hypot(jump.moved.x_m, jump.moved.y_m), 3),
                    "turned_rad": round(jump.moved.yaw_rad, 3),
                }
                for jump in self.slam.jumps
            ],
            "fit_median": round(self.fit_median, 3),
            "contradicted_median": round(self.contradicted, 3),
            "turn_disagreement": round(self.turn_disagreement, 3),
            "log_s": round(self.log_s, 3),
            "driven_m": round(self.driven_m, 2),
            "keyframes": len(self.graph.nodes),
            "loops": self.slam.loops,
            "loops_rejected": self.slam.loops_rejected,
            "edges": {
                kind: {"count": len(values), "mean_chi2": round(float(np.mean(values)), 4)}
                for kind, values in sorted(edges.items())
            },
            "map": {
                "rows": rows,
                "columns": columns,
                "resolution_m": grid.resolution_m,
                "known_m2": round(float((grid.cells >= 0).sum()) * grid.resolution_m**2, 1),
            },
            "elapsed_s": round(self.elapsed_s, 3),
            "times_real": round(self.log_s / self.elapsed_s, 1),
            "scan_ms": {
                "median": round(float(np.median(self.step_ms)), 3),
                "p99": round(float(np.percentile(self.step_ms, 99)), 3),
                "max": round(float(self.step_ms.max()), 3),
            },
        }


def run(
    log: Log,
    params: SlamParams,
    base_from_scan: SE2 | None = None,
    on_progress: Callable[[int, int, Slam], None] = lambda *_: None,
) -> Built:
    """Map a log; `on_progress` is called now and then with the numbers of scans done and of
    all scans, and the state.

    Raises ConfigError with a phrase where no scan could be used.
    """
    from mazebot.common.robot.frozen_scans import FROZEN, FrozenScans  # noqa: PLC0415 - load Numba
    from mazebot.mapping.slam import Slam  # noqa: PLC0415

    slam = Slam(params, SE2(0.0, 0.0, 0.0))
    scans = log.scans
    stamps_ns, anchors, fits, step_ms = [], [], [], []
    odometry = []
    frozen = FrozenScans()
    done, driven_m = 0, 0.0
    last: SE2 | None = None
    began = time.perf_counter()
    for step in log.steps():
        if step.odom_from_base is not None:
            slam.odometry(step.stamp_ns, step.odom_from_base)
            driven_m += 0.0 if last is None else last.distance_m(step.odom_from_base)
            last = step.odom_from_base
            odometry.append((step.stamp_ns * 1e-9, *last))
        if step.scan is None:
            continue
        begin = time.perf_counter()
        scan = step.scan.at(base_from_scan, step.stamp_ns)
        is_frozen = last is not None and frozen.is_frozen(scan, last)
        if is_frozen:
            slam.left_out[FROZEN] += 1
        used = not is_frozen and slam.scan(scan)
        step_ms.append((time.perf_counter() - begin) * 1e3)
        if used:
            stamps_ns.append(step.stamp_ns)
            anchors.append(slam.anchor())
            fits.append(slam.quality)
        done += 1
        if done % _PROGRESS_EVERY == 0:
            on_progress(done, scans, slam)
    if not stamps_ns:
        raise ConfigError(
            f"none of its {scans} scans can be used: {reasons(slam.left_out)}"
            if scans
            else "has no scans"
        )
    graph = slam.document(stamps_ns[-1])
    elapsed_s = time.perf_counter() - began
    poses = np.array([slam.graph.pose(node) @ of_node for node, of_node in anchors])
    times_s = np.array(stamps_ns, np.float64) * 1e-9
    return Built(
        slam, graph, times_s, poses, scans, np.array(fits), np.array(step_ms), elapsed_s,
        driven_m, np.array(odometry), float(np.median(slam.contradicted())),
    )  # fmt: skip


def reasons(left_out: Mapping[str, int]) -> str:
    """Why scans were left out, and how many, in one line."""
    return ", ".join(f"{count} {reason}" for reason, count in left_out.items() if count)


def turn_disagreement(times_s: Array, poses: Array, odometry: Array) -> float:
    """By how much the turns of a trajectory, (n, 3) at (n,) times, differ from those of odometry,
    (k, 4) with the time, as a share of the latter; 0 where the robot hardly turned.
    """
    yaws_rad = np.interp(times_s, odometry[:, 0], np.unwrap(odometry[:, 3]))
    by_odometry_rad = wrap_angles(np.diff(yaws_rad))
    by_scans_rad = wrap_angles(np.diff(poses[:, 2]))
    turned_rad = float(np.abs(by_odometry_rad).sum())
    if turned_rad < _LEAST_TURNED_RAD:
        return 0.0
    return float(np.abs(wrap_angles(by_scans_rad - by_odometry_rad)).sum()) / turned_rad
