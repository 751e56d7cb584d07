"""A recorder in a process of its own, fed as time passes, that is killed without notice:
`python -m tests.recorder.driven_recorder FOLDER START_NS KILLED_AFTER_S SAID_FILE`.
"""

from __future__ import annotations

import os
import signal
import struct
import sys
import threading
import time
from pathlib import Path

from mazebot.common.messages import topics as table
from mazebot.common.node.node import Envelope
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.node import RecorderNode
from tests.recorder.synthetic import Bench, driving, opening, room

SAID = struct.Struct("<qq")
"""Wall time and simulation time, in ns, at which something was said."""
SOURCE = "simulation"


def main(folder: Path, start_ns: int, killed_after_s: float, said_file: Path) -> None:
    """Feed a recorder with a drive; with 0, it ends after 2 s, and in order."""
    node = RecorderNode(RecorderConfig(recordings_dir=folder, min_free_mib=0))
    bench, world = Bench(node), room()
    said = said_file.open("wb", buffering=0)
    number = start_ns // 1000
    first = [(start_ns, topic, message) for _, topic, message in opening(world)]
    drive = list(driving(world, 30.0 if killed_after_s else 2.0, start_ns))
    # A latched message: it comes at once, and tells which run this is.
    first += [one for one in drive if one[1] is table.SIMULATION_STATS][:1]
    for now_ns, topic, message in first:
        bench.inbox.deliver(topic, message, Envelope(SOURCE, 0, now_ns, world.hash))
    bench.step(start_ns)
    if killed_after_s:
        # From now on, when all is loaded.
        kill = threading.Timer(killed_after_s, os.kill, (os.getpid(), signal.SIGKILL))
        kill.daemon = True
        kill.start()
    begin_s = time.monotonic()
    next_step_ns = 0
    for now_ns, topic, message in drive:
        left_s = begin_s + (now_ns - start_ns) * 1e-9 - time.monotonic()
        if left_s > 0.0:
            time.sleep(left_s)
        if now_ns >= next_step_ns:
            bench.step(now_ns)
            next_step_ns = now_ns + 100_000_000
        number += 1
        bench.inbox.deliver(topic, message, Envelope(SOURCE, number, now_ns, world.hash))
        if topic is table.CLOCK:
            said.write(SAID.pack(time.monotonic_ns(), now_ns))
    bench.step(next_step_ns)
    node.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), Path(sys.argv[4]))
