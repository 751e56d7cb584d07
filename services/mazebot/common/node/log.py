"""Logs in ROS style, on the console and on /rosout."""

from __future__ import annotations

import logging
import sys
from pathlib import PurePath
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mazebot.common.node.node import Outbox

LEVELS = {
    "DEBUG": logging.DEBUG,
    "INFO": logging.INFO,
    "WARN": logging.WARNING,
    "ERROR": logging.ERROR,
    "FATAL": logging.CRITICAL,
}
"""By their names in ROS 2."""
_ROS_NAMES = {level: name for name, level in LEVELS.items()}


class RosFormatter(logging.Formatter):
    """`[INFO] [node]: text`, as `ros2 launch` shows it."""

    def format(self, record: logging.LogRecord) -> str:
        """The line of a record; of an exception only the message, without the traceback."""
        level = _ROS_NAMES.get(record.levelno, record.levelname)
        text = record.getMessage()
        if record.exc_info and record.exc_info[1]:
            text = f"{text}: {record.exc_info[1]}"
        return f"[{level}] [{record.name}]: {text}"


class RosoutHandler(logging.Handler):
    """Publishes each record on /rosout through the outbox of the node that is running."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.outbox: Outbox | None = None

    def emit(self, record: logging.LogRecord) -> None:
        """Publish the record on /rosout."""
        if self.outbox is None:
            return
        # The router has logs, too, but no outbox: it need not load every message.
        from mazebot.common.messages import messages as msg  # noqa: PLC0415
        from mazebot.common.messages.topics import ROSOUT  # noqa: PLC0415

        self.outbox.put(
            ROSOUT,
            msg.Log(
                stamp=msg.time_from_ns(self.outbox.now_ns),
                level=min(max(record.levelno, 10), 50),
                name=record.name,
                msg=record.getMessage(),
                file=PurePath(record.pathname).name,
                function=record.funcName or "",
                line=record.lineno,
            ),
        )


def configure(console: logging.Handler | None = None) -> RosoutHandler:
    """Send every log to the console (standard output where no handler is given) and to /rosout."""
    handler = console or logging.StreamHandler(sys.stdout)
    handler.setFormatter(RosFormatter())
    rosout = RosoutHandler()
    root = logging.getLogger()
    root.handlers = [handler, rosout]
    root.setLevel(logging.INFO)
    # numba logs every compiler pass.
    logging.getLogger("numba").setLevel(logging.WARNING)
    return rosout
