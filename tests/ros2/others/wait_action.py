"""ENDPOINT SECONDS CANCEL KEYS: runs nav2_msgs/action/Wait for some seconds, by bytes made by hand
with Zenoh alone, and cancels it after the first feedback if CANCEL is 1. KEYS: those of send_goal,
cancel_goal, get_result, feedback and status, as JSON. Prints what happened as JSON.
"""

from __future__ import annotations

import json
import queue
import struct
import sys
import time
import uuid
from typing import Any

import zenoh
from sessions import opened

HEAD = b"\0\1\0\0"
_SEQUENCE = iter(range(1000))


def ask(session: zenoh.Session, key: str, payload: bytes) -> bytes:
    """The payload of the reply, whose attachment must be that of the request."""
    sequence, gid = next(_SEQUENCE), bytes(range(16))
    attachment = struct.pack("<qqB16s", sequence, time.time_ns(), 16, gid)
    (reply,) = session.get(
        key, payload=HEAD + payload, attachment=attachment, timeout=60.0,
        target=zenoh.QueryTarget.ALL_COMPLETE,
    )  # fmt: skip
    sample: Any = reply.ok
    got, _, length, back = struct.unpack("<qqB16s", sample.attachment.to_bytes())
    assert (got, length, back) == (sequence, 16, gid)
    return bytes(sample.payload.to_bytes())


def main(endpoint: str, seconds: float, cancels: bool, keys: dict[str, str]) -> dict[str, Any]:
    """One goal from its beginning to its end."""
    session, goal_id = opened(endpoint, "peer"), uuid.uuid4().bytes
    told: queue.Queue[bytes] = queue.Queue()
    statuses: list[int] = []
    subscriber = session.declare_subscriber(
        keys["feedback"], lambda sample: told.put(sample.payload.to_bytes())
    )
    status = zenoh.ext.declare_advanced_subscriber(
        session, keys["status"],
        # Of the goal that was sent last: behind its id and stamp.
        lambda sample: statuses.append(sample.payload.to_bytes()[-1]),
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
    )  # fmt: skip
    whole = int(seconds)
    duration = struct.pack("<iI", whole, int((seconds - whole) * 1e9))
    accepted = struct.unpack_from("<4x?3xiI", ask(session, keys["send_goal"], goal_id + duration))
    first = told.get(timeout=60.0)
    assert first[4:20] == goal_id
    left = struct.unpack_from("<iI", first, 20)
    found: dict[str, Any] = {"accepted": accepted[0], "left_s": left[0] + left[1] * 1e-9}
    if cancels:
        answer = ask(session, keys["cancel_goal"], goal_id + bytes(8))
        found["cancel"] = struct.unpack_from("<4xb3xI", answer)
        found["same"] = answer[12:28] == goal_id
    answer = ask(session, keys["get_result"], goal_id)
    result, _, _, code = struct.unpack_from("<4xb3xiIH", answer)
    found |= {"status": result, "error_code": code}
    end_s = time.monotonic() + 20.0
    while statuses[-1:] != [result] and time.monotonic() < end_s:
        time.sleep(0.01)
    found["statuses"] = statuses
    subscriber.undeclare()
    status.undeclare()  # type: ignore[no-untyped-call]
    session.close()
    return found


if __name__ == "__main__":
    place, length, cancel, names = sys.argv[1:]
    sys.stdout.write(json.dumps(main(place, float(length), cancel == "1", json.loads(names))))
