"""`mazebot replay RUN --service NAME`: prints what a service does otherwise than in a recording."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from mazebot.cli.parsing.options import print_json
from mazebot.cli.replay.comparison import Comparison, Difference, TopicComparison
from mazebot.cli.replay.in_process import replay_through
from mazebot.cli.replay.progress import shown
from mazebot.cli.replay.reading.recording import Recording
from mazebot.cli.replay.reading.replayed import between, in_time
from mazebot.cli.replay.settings import Settings, make_node, settings_of
from mazebot.common.config import ConfigError

_MOST_LINES = 12
_MOST_FIELDS = 4


def compare_service(
    recording: Recording,
    service: str,
    span_ns: tuple[int, int],
    path: Path | None,
    overrides: list[str],
    as_json: bool,
) -> int:
    """Replay a recording through a service, and print the differences; 0: there are none, else 1.

    Raises ConfigError where the service did not run, or a setting is invalid.
    """
    recorded = recording.parameters.get(service, {})
    if recording.is_run and not recorded:
        ran = ", ".join(sorted(recording.parameters)) or "none"
        raise ConfigError(
            f"--service: {service}: did not run in {recording.name}: must be one of {ran}"
        )
    settings = settings_of(service, recorded, path, overrides)
    # What the service logs has been read once.
    logging.getLogger().handlers = [logging.NullHandler()]
    node = make_node(service, settings.config)
    # It needs what came before the part that is compared.
    start_ns = recording.start_ns
    messages = between(in_time(recording.read()), start_ns, span_ns[1])
    try:
        with shown(start_ns, span_ns[1]) as watch:
            comparison = replay_through(
                node, messages, start_ns, span_ns[0], recording.pictures == "raw", watch
            )
        waits_for = node.waiting_for()
    finally:
        node.close()
    if as_json:
        print_json(_summary(recording, service, span_ns, settings, comparison, waits_for))
    else:
        _tell(recording, service, span_ns, settings, comparison, waits_for)
    return 0 if comparison.is_same else 1


def _summary(
    recording: Recording,
    service: str,
    span_ns: tuple[int, int],
    settings: Settings,
    comparison: Comparison,
    waits_for: str | None,
) -> dict[str, Any]:
    return {
        "recording": recording.name,
        "service": service,
        "start_s": span_ns[0] * 1e-9,
        "end_s": span_ns[1] * 1e-9,
        "pictures": recording.pictures,
        "gap": recording.gap,
        "faults": list(recording.faults),
        "settings": {name: list(values) for name, values in settings.changed.items()},
        "left_out": recording.lines_of_unfit(),
        "rejected": rejected_lines(comparison, service),
        "waits_for": waits_for,
        **summary_of(comparison),
    }


def summary_of(comparison: Comparison) -> dict[str, Any]:
    """A comparison as JSON values."""
    return {
        "same": comparison.is_same,
        "messages": sum(one.same for one in comparison.topics),
        "topics": [_row(one) for one in comparison.topics],
    }


def _row(one: TopicComparison) -> dict[str, Any]:
    first = one.first
    return {
        "topic": one.topic,
        "recorded": one.recorded,
        "replayed": one.replayed,
        "same": one.same,
        "first_difference": None
        if first is None
        else {
            "time_s": first.time_ns * 1e-9,
            "message": first.number,
            "only_in": first.only_in,
            "field": first.field,
            "recorded": first.recorded,
            "replayed": first.replayed,
        },
        "largest_differences": one.largest,
    }


def _tell(
    recording: Recording,
    service: str,
    span_ns: tuple[int, int],
    settings: Settings,
    comparison: Comparison,
    waits_for: str | None,
) -> None:
    start_s, end_s = (time_ns * 1e-9 for time_ns in span_ns)
    lines = [f"{service} against {recording.name}, {start_s:.3f} s to {end_s:.3f} s"]
    lines += [
        f"{service}.{name}: {was} recorded, {now} here"
        for name, (was, now) in settings.changed.items()
    ]
    lines += picture_lines(recording, service)
    lines += recording.lines_of_unfit()
    lines += rejected_lines(comparison, service)
    if waits_for is not None:
        lines.append(f"at the end {service} is still waiting for {waits_for}")
    sys.stdout.write("\n".join(lines) + "\n")
    print_comparison(comparison)
    if not (comparison.is_same or recording.in_one_process):
        sys.stdout.write("recorded on the bus: exact only if all services ran in lockstep there\n")


def rejected_lines(comparison: Comparison, service: str) -> list[str]:
    """What the service did not take, a line for each topic and reason."""
    return [
        f"rejected by {service}: {topic}: {count} message{'s' * (count != 1)}: {reason}"
        for (topic, reason), count in comparison.rejected.items()
    ]


def picture_lines(recording: Recording, service: str) -> list[str]:
    """What the recorded pictures leave open."""
    if service != "perception" or recording.pictures == "raw":
        return []
    if recording.pictures == "none":
        return ["recorded without images: perception has no input"]
    return [
        f"recorded with compressed images ({recording.pictures}); perception can only be "
        "compared exactly "
        "with `pictures: raw`"
    ]


def print_comparison(comparison: Comparison) -> None:
    """Print a comparison: the counts by topic, and the first differences."""
    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("topic", "recorded", "replayed", "same", "largest differences"):
        table.add_column(heading, justify="right" if heading in _COUNTS else "left")
    for one in comparison.topics:
        counts = (f"{count:,}" for count in (one.recorded, one.replayed, one.same))
        table.add_row(one.topic, *counts, _largest(one))
    console = Console()
    if not console.is_terminal:
        console.width = 160
    console.print(table)
    sys.stdout.write("\n".join(_difference_lines(comparison)) + "\n")


_COUNTS = ("recorded", "replayed", "same")


def _largest(one: TopicComparison) -> str:
    ordered = sorted(one.largest.items(), key=lambda item: -item[1])[:_MOST_FIELDS]
    return ", ".join(f"{name} {apart:.3g}" for name, apart in ordered)


def _difference_lines(comparison: Comparison) -> Iterator[str]:
    same = sum(one.same for one in comparison.topics)
    found = [(one.first, one.topic) for one in comparison.topics if one.first is not None]
    if not found:
        yield f"the same: {same} messages on {len(comparison.topics)} topics"
        return
    found.sort(key=lambda item: (item[0].time_ns, item[1]))
    for number, (difference, topic) in enumerate(found[:_MOST_LINES]):
        begin = "first difference" if number == 0 else "then"
        yield f"{begin:>16}: {_line(difference, topic)}"
    yield f"{same} messages are the same"


def _line(difference: Difference, topic: str) -> str:
    begin = f"{difference.time_ns * 1e-9:.3f} s, {topic}: message {difference.number}"
    if difference.only_in is not None:
        return f"{begin} is in the {difference.only_in} only"
    return (
        f"{begin}: {difference.field}: {difference.recorded} recorded, {difference.replayed} here"
    )
