"""`make fuzz`: malformed messages to everything that reads any, with one seed."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from mazebot.bench.ending import run
from mazebot.bench.fuzz.decoders import (
    MEMORY_MB,
    Report,
    fuzz_requests,
    fuzz_topics,
    memory_after,
    real_messages,
)
from mazebot.bench.fuzz.live import LiveReport, fuzz_stack
from mazebot.common.config import ConfigError, fail

_TELL_S = 1.5


class Progress:
    """A line now and then."""

    def __init__(self) -> None:
        self._told_s = 0.0

    def __call__(self, text: str) -> None:
        """Tell what is being done."""
        if time.monotonic() - self._told_s >= _TELL_S:
            self._told_s = time.monotonic()
            sys.stderr.write(f"{text}\n")
            sys.stderr.flush()


def main(arguments: Sequence[str]) -> int:
    """Do it; the exit code is 1 where something was found."""
    parser = argparse.ArgumentParser(prog="make fuzz", description=__doc__)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--cases", type=int, default=100_000, help="of each topic and request")
    parser.add_argument("--seconds", type=float, default=60.0, help="on a running stack; 0: none")
    parser.add_argument("--json", default="", help="write a report")
    parser.add_argument("--found", default="fuzz-findings", help="folder for what was found")
    options = parser.parse_args(arguments)
    tell, reports = Progress(), list[Report]()
    tell("a short drive, for valid messages")
    real = real_messages(options.seed)

    def decode() -> None:
        reports.extend(fuzz_topics(options.seed, options.cases, real, tell))
        reports.extend(fuzz_requests(options.seed, options.cases, real, tell))

    grown_mb = memory_after(decode)
    live = LiveReport()
    if options.seconds > 0.0:
        with tempfile.TemporaryDirectory(prefix="mazebot-fuzz-") as name:
            try:
                live = fuzz_stack(options.seed, options.seconds, real, Path(name), tell)
            except ConfigError as error:
                fail(str(error))
    problems = _told(reports, live, grown_mb, Path(options.found))
    if options.json:
        values = {
            "seed": options.seed, "cases": options.cases, "grown_mb": grown_mb,
            "decoded": [
                {"name": one.name, "sent": one.sent, "rejected": one.rejected, "valid": one.valid}
                for one in reports
            ],
            "stack": vars(live), "problems": problems,
        }  # fmt: skip
        Path(options.json).write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    return 1 if problems else 0


def _told(reports: Sequence[Report], live: LiveReport, grown_mb: float, folder: Path) -> list[str]:
    """Print what came of it, and keep the inputs that show a fault; the faults in words."""
    sent, valid = sum(one.sent for one in reports), sum(one.valid for one in reports)
    say = sys.stdout.write
    say(
        f"{sent:,} messages and requests of {len(reports)} kinds decoded: {sent - valid:,} "
        f"rejected and counted, {valid:,} still valid; memory {grown_mb:+.0f} MB\n"
    )
    if live.sent:
        most = max(live.grown_mb.values(), default=0.0)
        say(
            f"{live.sent:,} messages and {live.queries:,} queries to a running stack: "
            f"{live.goals_reached} goals reached meanwhile; memory {most:+.0f} MB at most\n"
            f"{live.answered:,} answers to a flood of {live.requests:,} goals; a client joins "
            f"beside silent connections within {live.join_s:.2f} s\n"
        )
        for trouble, p99_ms in live.period_p99_ms.items():
            say(f"velocity commands, p99 of their period, with {trouble}: {p99_ms:.0f} ms\n")
    problems = list(live.findings)
    if grown_mb > MEMORY_MB:
        problems.append(f"decoding has grown by {grown_mb:.0f} MB")
    for one in reports:
        for number, finding in enumerate(one.findings[:5]):
            folder.mkdir(parents=True, exist_ok=True)
            file = folder / f"{one.name.strip('/').replace('/', '.')}-{number}.bin"
            file.write_bytes(finding.data)
            problems.append(f"{one.name}: {finding.problem} ({file})")
    for problem in problems:
        say(f"found: {problem}\n")
    return problems


if __name__ == "__main__":
    run(main)
