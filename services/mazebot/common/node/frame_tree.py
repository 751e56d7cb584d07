"""The TF tree from the transforms received so far."""

from __future__ import annotations

from collections.abc import Iterable

from mazebot.common.maths.frames import Array
from mazebot.common.messages.messages import TFMessage, TransformStamped, chain_transforms, has_ring
from mazebot.common.messages.topics import Topic
from mazebot.common.node.node import Inbox

MAX_FRAMES = 2000
"""Several times the frames of a robot and the maximum number of moving bodies."""
_TOO_MANY = "too many frames"


class FrameNames:
    """The known frame names. A message that would exceed MAX_FRAMES is refused."""

    def __init__(self) -> None:
        self._names: set[str] = set()

    def add(self, message: TFMessage) -> str:
        """Add transforms; return a short reason if they are refused, else an empty string."""
        new = {entry.child_frame_id for entry in message.transforms} - self._names
        if len(self._names) + len(new) > MAX_FRAMES:
            return _TOO_MANY
        self._names |= new
        return ""


class FrameTree:
    """The newest transform of each frame. A message that would make a cycle or too many frames is
    refused as a whole.
    """

    def __init__(self) -> None:
        self._entries: dict[str, TransformStamped] = {}
        self._chains: dict[tuple[str, str], Array | None] = {}
        """Those that were asked for since the last transform came."""

    def add(self, message: TFMessage) -> str:
        """Add transforms; return a short reason if they are refused, else an empty string."""
        entries = self._entries
        moved = [
            entry
            for entry in message.transforms
            if entry.child_frame_id not in entries
            or entries[entry.child_frame_id].header.frame_id != entry.header.frame_id
        ]
        if moved:
            parents = {child: entry.header.frame_id for child, entry in entries.items()}
            parents |= {entry.child_frame_id: entry.header.frame_id for entry in moved}
            if len(parents) > MAX_FRAMES:
                return _TOO_MANY
            if has_ring(parents):
                return "loop in the frame tree"
        entries.update((entry.child_frame_id, entry) for entry in message.transforms)
        self._chains.clear()
        return ""

    def receive(self, inbox: Inbox, topic: Topic[TFMessage]) -> bool:
        """Add the new messages of a topic, and reject those that are refused; return whether one
        was added.
        """
        added = False
        for message in inbox.new(topic):
            problem = self.add(message)
            if problem:
                inbox.reject(topic, problem)
            else:
                added = True
        return added

    def chains(self, parent_frame: str, child_frames: Iterable[str]) -> dict[str, Array]:
        """Rigid (4, 4) `parent_from_child` of each frame that is connected, by its name."""
        found = {frame: self.chain(parent_frame, frame) for frame in child_frames}
        return {frame: matrix for frame, matrix in found.items() if matrix is not None}

    def chain(self, parent_frame: str, child_frame: str) -> Array | None:
        """Rigid (4, 4) `parent_from_child`, not to be modified; None where no transforms connect
        the frames.
        """
        ends = parent_frame, child_frame
        if ends not in self._chains:
            self._chains[ends] = chain_transforms(self._entries.values(), *ends)
        return self._chains[ends]
