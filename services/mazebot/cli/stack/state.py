"""What is known of a stack on this machine: its folder, and the processes in it."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Literal

from pydantic import BaseModel, ValidationError

from mazebot.common.config import ConfigError
from mazebot.common.files.key_file import KEYS, is_own, stacks_folder, stacks_folders

_STATE, _LOCK = "state.json", "lock"

Phase = Literal["starting", "waiting", "active", "restarting", "ended"]


class ProcessId(BaseModel):
    """A process, even after its number is used by another one."""

    pid: int
    started_ticks: int
    """When it started, in the kernel's ticks since the machine did."""

    @classmethod
    def of(cls, pid: int) -> ProcessId:
        """The process that has this number now."""
        return cls(pid=pid, started_ticks=_started_ticks(pid) or 0)

    def runs(self) -> bool:
        """Whether this very process runs."""
        return self.started_ticks > 0 and _started_ticks(self.pid) == self.started_ticks

    def send(self, number: int) -> None:
        """Send a signal, unless the process has ended."""
        if self.runs():
            os.kill(self.pid, number)


def _started_ticks(pid: int) -> int | None:
    """None: there is no such process, or it has ended and only its exit code is left."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    # The name of the program, in parentheses, may hold anything.
    fields = text.rpartition(")")[2].split()
    return None if fields[0] in "ZX" else int(fields[19])


class ServiceState(BaseModel):
    """One service of a stack."""

    name: str
    process: ProcessId | None = None
    since_s: float
    """Unix time since which it has been in this process, or has had none."""
    phase: Phase = "starting"
    waits_for: str = ""
    restarts: int = 0
    exit_code: int | None = None
    """How it ended last."""

    @property
    def text(self) -> str:
        """Its state in words."""
        if self.phase == "waiting":
            return f"waiting for {self.waits_for}"
        if self.phase in ("ended", "restarting") and self.exit_code is not None:
            return f"{self.phase} ({how_ended(self.exit_code)})"
        return self.phase


class StackState(BaseModel):
    """A stack that runs."""

    endpoint: str
    about: str
    """What runs, in a few words."""
    supervisor: ProcessId
    since_s: float
    services: list[ServiceState]

    def service(self, name: str) -> ServiceState | None:
        """The service of this name; None: it is not part of the stack."""
        return next((one for one in self.services if one.name == name), None)


def how_ended(code: int) -> str:
    """An exit code in words."""
    return f"exit code {code}" if code >= 0 else f"signal {-code}"


class StackFolder:
    """The folder of the stack of one user on one port."""

    def __init__(self, port: int) -> None:
        """That in which it runs, or has run, or would run first. Raises ConfigError where the
        folder of new stacks belongs to another user.
        """
        self.port = port
        new = _stacks() / str(port)
        there = [path for folder in stacks_folders() if (path := folder / str(port)).is_dir()]
        self.path = next(filter(_running_in, there), next(iter(there), new))

    def locked(self) -> BinaryIO | None:
        """The lock of the stack, as an open file; None: another process has it."""
        self.path.mkdir(mode=0o700, exist_ok=True)
        file = (self.path / _LOCK).open("wb")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.close()
            return None
        return file

    def write(self, state: StackState) -> None:
        """Replace the state."""
        new = self.path / f"{_STATE}.new"
        new.write_text(state.model_dump_json(), encoding="utf-8")
        new.replace(self.path / _STATE)

    def read(self) -> StackState | None:
        """The state as last written; None: no stack was started, or it was ended by `down`."""
        return _state_in(self.path)

    def running(self) -> StackState | None:
        """The state of the stack if it runs, or a process of it does."""
        return _running_in(self.path)

    def use_keys(self, folder: Path | None) -> None:
        """Let this user's tools find the keys of the stack; None: it has none."""
        (self.path / KEYS).unlink(missing_ok=True)
        if folder is not None:
            (self.path / KEYS).symlink_to(folder)

    def forget(self) -> None:
        """The stack has ended."""
        (self.path / _STATE).unlink(missing_ok=True)
        self.use_keys(None)


def _state_in(path: Path) -> StackState | None:
    try:
        return StackState.model_validate_json((path / _STATE).read_bytes())
    except (OSError, ValidationError):
        return None


def _running_in(path: Path) -> StackState | None:
    state = _state_in(path)
    if state is None:
        return None
    processes = [state.supervisor, *(one.process for one in state.services if one.process)]
    return state if any(process.runs() for process in processes) else None


def running_stacks() -> Iterator[StackState]:
    """All stacks of this user, by port."""
    names = {path.name for folder in stacks_folders() for path in folder.iterdir()}
    for port in sorted(int(name) for name in names if name.isdecimal()):
        state = StackFolder(port).running()
        if state is not None:
            yield state


def _stacks() -> Path:
    """The folder of new stacks of this user, readable by nobody else.

    Raises ConfigError where it belongs to another user.
    """
    folder = stacks_folder()
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    if not is_own(folder):
        raise ConfigError(f"{folder}: must be a folder that only you may write: remove it")
    return folder
