"""Readers of everything on a bus: `python -m mazebot.bench.fuzz.crowd ENDPOINT COUNT`."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import open_session
from mazebot.common.config import ConfigError

READERS, STOPPED = 20, 5
_EACH = 5
"""Readers of one process."""
_OPEN_S = 30.0


@contextmanager
def crowd(endpoint: str) -> Iterator[None]:
    """READERS sessions that subscribe to everything, of which STOPPED are stopped once they have.

    Raises ConfigError where they cannot.
    """
    command = [sys.executable, "-m", "mazebot.bench.fuzz.crowd", endpoint, str(_EACH)]
    with ExitStack() as ending:
        processes = []
        for _ in range(READERS // _EACH):
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            ending.callback(process.communicate)
            ending.callback(process.kill)
            processes.append(process)
        for process in processes:
            assert process.stdout is not None
            if process.stdout.readline() != b"reading\n":
                raise ConfigError("a reader of everything has ended")
        for process in processes[: STOPPED // _EACH]:
            process.send_signal(signal.SIGSTOP)
        yield


def main(arguments: Sequence[str]) -> None:
    """Read until the standard input ends."""
    endpoint, count = arguments
    sessions = [open_session(BusConfig(connect=endpoint), _OPEN_S) for _ in range(int(count))]
    for session in sessions:
        session.declare_subscriber("**", lambda sample: len(sample.payload))
    sys.stdout.write("reading\n")
    sys.stdout.flush()
    sys.stdin.read()


if __name__ == "__main__":
    main(sys.argv[1:])
