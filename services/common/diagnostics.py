"""What every service says of itself on /diagnostics."""

from __future__ import annotations

from services.common import messages as msg
from services.common.node import Inbox, Node, Outbox

WAITING_KEY = "waiting_for"
REJECTED_KEY = "rejected "
LOST_KEY = "lost "

_OK, _WARN = 0, 1


def diagnostics(now_ns: int, node: Node, inbox: Inbox, outbox: Outbox) -> msg.DiagnosticArray:
    """State of a node: what it waits for, what it rejected by topic and reason, what never came."""
    waiting = node.waiting_for()
    values = [msg.KeyValue(key=WAITING_KEY, value=waiting or "")]
    for topic, counts in inbox.counts.items():
        for reason, count in counts.rejected.items():
            values.append(msg.KeyValue(key=f"{REJECTED_KEY}{topic}: {reason}", value=str(count)))
        if counts.lost:
            values.append(msg.KeyValue(key=f"{LOST_KEY}{topic}", value=str(counts.lost)))
    for (topic, reason), count in outbox.rejected.items():
        values.append(msg.KeyValue(key=f"{REJECTED_KEY}{topic}: own, {reason}", value=str(count)))
    status = msg.DiagnosticStatus(
        level=_WARN if waiting or len(values) > 1 else _OK,
        name=node.name,
        message=f"waiting for {waiting}" if waiting else "active",
        hardware_id="",
        values=values,
    )
    return msg.DiagnosticArray(header=msg.header(now_ns, ""), status=[status])
