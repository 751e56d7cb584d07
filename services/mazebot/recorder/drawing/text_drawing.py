"""What is drawn as text: the services' logs and parameters, results, the behaviour tree."""

from __future__ import annotations

import re

import rerun as rr

from mazebot.common.figures.goal_table import HEADINGS, error_lines, failure_lines, goal_rows
from mazebot.common.figures.mapping_table import mapping_rows
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.recorder.drawing.canvas import LATCH_NS, Canvas, entity_part

_SECOND_NS = 1_000_000_000
_MAPPING_NS = 5_000_000_000
_MOST_GOALS = 50
"""Goals in the table of results, newest: a run may have thousands, and each one logs a table."""
_MARKS = {"RUNNING": "▶", "SUCCESS": "✔", "FAILURE": "✖", "SKIPPED": "○", "IDLE": "·"}
_ERROR = 40
_LEVELS = ((50, "CRITICAL"), (40, "ERROR"), (30, "WARN"), (20, "INFO"), (0, "DEBUG"))


def draw_world_request(canvas: Canvas, request: doc.WorldRequest) -> None:
    """The requested world."""
    canvas.recording.at(canvas.now_ns)
    values = rr.AnyValues(
        world_name=request.world_name,
        use_aruco=request.use_aruco,
        overrides=list(request.overrides),
    )
    canvas.recording.log("world/request", values)


def draw_world_status(canvas: Canvas, status: doc.WorldStatus) -> None:
    """The state of a world request."""
    canvas.recording.at(canvas.now_ns)
    name = status.request.world_name
    values = rr.AnyValues(world_name=name, world_hash=status.world_hash, error=status.error)
    canvas.recording.log("world/status", values)


def draw_parameters(canvas: Canvas, parameters: doc.Parameters) -> None:
    """The configuration of a service, as a document."""
    lines = [f"- {name}: {value}" for name, value in parameters.values.items()]
    text = "\n".join([f"# {parameters.service}", *lines])
    path = f"parameters/{entity_part(parameters.service)}"
    if canvas.changed(path, text):
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        canvas.recording.log(path, document, static=True)


def draw_simulation_stats(canvas: Canvas, stats: doc.SimulationStats) -> None:
    """The state hash, and the watchdog's stops."""
    stamp_ns = round(stats.sim_time_s * 1e9)
    canvas.recording.at(stamp_ns)
    if canvas.due("simulation/stats", stamp_ns, _SECOND_NS):
        canvas.recording.log(
            "simulation/stats",
            rr.AnyValues(
                state_hash=stats.state_hash, iterations=stats.iterations, paused=stats.paused
            ),
        )
        canvas.recording.scalar("simulation/stats/watchdog_stops", stats.watchdog_stops)
    stops = canvas.last.get("simulation/stats/watchdog_stops")
    if canvas.changed("simulation/stats/watchdog_stops", stats.watchdog_stops):
        if isinstance(stops, int) and stats.watchdog_stops > stops:
            canvas.event(
                "fault", "no command received in time: the watchdog stopped the robot", "WARN"
            )
    if stats.paused:
        # While paused, the real-time factor is not measured.
        canvas.real_time = None
    if canvas.changed("simulation/stats/renderer", stats.renderer):
        canvas.log_text("simulation/stats", f"renderer: {stats.renderer}")


def draw_behavior_tree(canvas: Canvas, log: act.BehaviorTreeLog) -> None:
    """The tree, indented, with a mark for what each node answered."""
    path, now_ns = "behavior_tree", canvas.now_ns
    if not canvas.changed(path, log) and not canvas.due(path, now_ns, LATCH_NS):
        return
    canvas.due(path, now_ns, 0)
    lines = [f"# {_escaped(log.action.replace('_', ' ') or 'no action')}", "", "```"]
    for node in log.nodes:
        label = node.kind if node.name == node.kind else f"{node.kind} {node.name!r}"
        lines.append(f"{_MARKS[node.status]} {'  ' * node.depth}{label.replace('`', ' ')}")
    legend = "running, succeeded, failed, skipped, not ticked"
    marks = zip(_MARKS.values(), legend.split(", "), strict=True)
    lines += ["```", "", ", ".join(f"{mark} {word}" for mark, word in marks)]
    canvas.recording.at(now_ns)
    document = rr.TextDocument("\n".join(lines), media_type=rr.MediaType.MARKDOWN)
    canvas.recording.log(path, document)
    running = _running(log)
    if canvas.changed("behavior_tree/running", running):
        canvas.recording.log("behavior_tree/running", rr.StateChange(state=running))


def _running(log: act.BehaviorTreeLog) -> str:
    """The kind of the deepest node that runs, the last of them if several do."""
    running = [node for node in log.nodes if node.status == "RUNNING"]
    if not running:
        return "no action" if not log.action else "between ticks"
    deepest = max(node.depth for node in running)
    return [node.kind for node in running if node.depth == deepest][-1]


def draw_rosout(canvas: Canvas, log: msg.Log) -> None:
    """A line of a service's log."""
    canvas.at(log.stamp)
    if log.level >= _ERROR:
        canvas.event("fault", f"{log.name}: {log.msg}", "ERROR")
    canvas.recording.log(
        f"rosout/{entity_part(log.name)}",
        rr.TextLog(f"[{log.name}]: {log.msg}", level=_level(log.level)),
    )


def _level(level: int) -> str:
    return next(name for least, name in _LEVELS if level >= least)


def draw_evaluation(canvas: Canvas, evaluation: doc.Evaluation, final: bool = False) -> None:
    """The table of goals as a document: logged for each goal that ends, and at a run's end."""
    if evaluation.mapping is not None:
        _draw_mapping(canvas, evaluation, final)
        return
    rows = tuple(goal_rows(evaluation.goals[-_MOST_GOALS:]))
    if not canvas.changed("evaluation", (len(evaluation.goals), rows)) and not final:
        return
    left_out = len(evaluation.goals) - len(rows)
    counted = [goal for goal in evaluation.goals if not goal.given_up]
    reached = sum(goal.reached for goal in counted)
    lines = [f"# {reached} of {len(counted)} goals reached" if rows else "# No goal yet"]
    if rows:
        lines += ["", _table_row(HEADINGS), "| --- " + "| ---: " * (len(HEADINGS) - 1) + "|"]
        lines += [_table_row(row) for row in rows]
    if left_out:
        lines += ["", f"{left_out} earlier goals are in summary.json."]
    shown = evaluation.goals[-_MOST_GOALS:]
    lines += ["", *(f"- {_escaped(line)}" for line in failure_lines(shown))]
    lines += ["", *(f"- {line}" for line in error_lines(evaluation))]
    canvas.recording.at(canvas.now_ns)
    document = rr.TextDocument("\n".join(lines), media_type=rr.MediaType.MARKDOWN)
    canvas.recording.log("evaluation", document)


def _draw_mapping(canvas: Canvas, evaluation: doc.Evaluation, final: bool) -> None:
    """The map's figures as a document, every few seconds and at the run's end."""
    mapping = evaluation.mapping
    if mapping is None or not (final or canvas.due("evaluation", canvas.now_ns, _MAPPING_NS)):
        return
    state = f"# Exploration: {mapping.exploration}" if mapping.exploration else "# Mapping"
    lines = [state, "", _escaped(mapping.exploration_reason), "", "| | |", "| --- | --- |"]
    lines += [_table_row(row) for row in mapping_rows(mapping)]
    lines += ["", *(f"- {line}" for line in error_lines(evaluation))]
    canvas.recording.at(canvas.now_ns)
    document = rr.TextDocument("\n".join(lines), media_type=rr.MediaType.MARKDOWN)
    canvas.recording.log("evaluation", document)


def _table_row(cells: tuple[str, ...]) -> str:
    """In Markdown; special characters in names are escaped."""
    return "| " + " | ".join(map(_escaped, cells)) + " |"


def _escaped(text: str) -> str:
    """Text as it is shown, where it may hold Markdown's own characters."""
    return re.sub(r"([\\`*_\[\]<>|])", r"\\\1", text)
