"""Compiles kernels side by side, in as many processes as there are processors, before this process
would compile them one after the other.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.kernels import USE_LISTENERS, Kernel, cache_folder, environment
from mazebot.common.processors import processors
from mazebot.embedded.compile_progress import CompileProgress
from mazebot.embedded.compiler import FAILED, WHOLE
from mazebot.embedded.kernel_list import listed

_SOURCES = Path(__file__).parents[2]
_LOOK_S = 0.1


class CompilingStoppedError(Exception):
    """The caller did not want to wait any longer."""


@contextlib.contextmanager
def compiled_side_by_side(
    progress: CompileProgress, is_stopped: Callable[[], bool] = lambda: False
) -> Iterator[None]:
    """Within this context, a kernel that has yet to be compiled is waited for, while processes
    compile it and all others of the modules that are imported. They end with the context.

    Raises CompilingStoppedError from a kernel's first call if `is_stopped` while it is waited for.
    """
    compiling = Compiling(progress, is_stopped)
    USE_LISTENERS.append(compiling.await_kernel)
    try:
        yield
    finally:
        USE_LISTENERS.remove(compiling.await_kernel)
        compiling.close()


class Compiling:
    """Processes that compile modules, and what they have compiled."""

    def __init__(
        self, progress: CompileProgress, is_stopped: Callable[[], bool] = lambda: False
    ) -> None:
        self._progress = progress
        self._is_stopped = is_stopped
        self._gave_up = False
        self._counts = Counter(one.module for one in listed())
        self._of_kernel = Counter((one.module, one.name) for one in listed())
        self._done = _Done()
        self._queue: list[str] = []
        self._queued: set[str] = set()
        self.failed: list[str] = []
        """Modules that could not be compiled."""
        self._compiled: Counter[tuple[str, str]] = Counter()
        self._changed = threading.Condition()
        self._processes: dict[subprocess.Popen[str], threading.Thread] = {}

    def await_kernel(self, kernel: Kernel) -> None:
        """Return once a kernel is on the disk, or cannot be had from these processes."""
        module, key = kernel.module, (kernel.module, kernel.name)
        if self._gave_up or key not in self._of_kernel or self._done.is_done(module):
            return
        with self._changed:
            self._start([module, *(one for one in self._counts if one in sys.modules)])
            if module in self._queue:
                self._queue.remove(module)
                self._queue.insert(0, module)
        self._wait(
            lambda: self._done.is_done(module) or self._compiled[key] == self._of_kernel[key]
        )

    def compile_all(self) -> None:
        """Compile the whole list."""
        with self._changed:
            self._start(self._counts)
        self._wait(lambda: all(map(self._done.is_done, self._queued)))

    def close(self) -> None:
        """End the processes."""
        with self._changed:
            self._queue.clear()
        for process, thread in self._processes.items():
            process.kill()
            thread.join()
            process.wait()

    def _wait(self, is_reached: Callable[[], bool]) -> None:
        with self._changed, self._progress.waiting() as show:
            while not is_reached():
                show(self._compiled.total(), sum(self._counts[one] for one in self._queued))
                if self._is_stopped():
                    # What is closed now needs kernels, too.
                    self._gave_up = True
                    raise CompilingStoppedError
                self._changed.wait(_LOOK_S)

    def _start(self, modules: Iterable[str]) -> None:
        """Queue modules, and start as many processes as have something to do."""
        for module in modules:
            if module not in self._queued and not self._done.is_done(module):
                self._queue.append(module)
                self._queued.add(module)
        running = sum(thread.is_alive() for thread in self._processes.values())
        for _ in range(min(processors() - running, len(self._queue))):
            process = subprocess.Popen(
                [sys.executable, "-m", "mazebot.embedded.compiler"],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1,
            )  # fmt: skip
            thread = threading.Thread(target=self._feed, args=(process,), daemon=True)
            self._processes[process] = thread
            thread.start()

    def _feed(self, process: subprocess.Popen[str]) -> None:
        """Give a process modules until there are no more."""
        assert process.stdin is not None
        assert process.stdout is not None
        while True:
            with self._changed:
                if not self._queue:
                    break
                module = self._queue.pop(0)
            with contextlib.suppress(BrokenPipeError):
                process.stdin.write(f"{module}\n")
            # A process that was killed answers nothing more.
            answer = FAILED
            for line in process.stdout:
                answer = line.strip()
                if answer in {WHOLE, FAILED}:
                    break
                with self._changed:
                    self._compiled[module, answer] += 1
                    self._changed.notify_all()
            with self._changed:
                # What has failed is compiled by this process, which tells why it cannot be.
                self._done.add(module, keep=answer == WHOLE)
                if answer != WHOLE:
                    self.failed.append(module)
                self._changed.notify_all()
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()
        process.stdout.close()


class _Done:
    """Which modules are compiled, with their digests in a file beside the machine code."""

    def __init__(self) -> None:
        self._file = cache_folder(portable_kernels.sin) / "mazebot_compiled.json"
        self._environment = environment()
        self._digests = self._read()
        self._done: dict[str, bool] = {}

    def is_done(self, module: str) -> bool:
        """Whether all that the list has of a module is compiled, of its present source."""
        if module not in self._done:
            self._done[module] = self._digests.get(module) == _digest(module)
        return self._done[module]

    def add(self, module: str, keep: bool) -> None:
        """A module is compiled; `keep`: so that later processes know."""
        self._done[module] = True
        if not keep:
            return
        # Another process may have added to it.
        self._digests = {**self._read(), module: _digest(module)}
        written = self._file.with_suffix(f".{os.getpid()}")
        with contextlib.suppress(OSError):
            written.write_text(json.dumps({self._environment: self._digests}), encoding="utf-8")
            written.replace(self._file)

    def _read(self) -> dict[str, str]:
        try:
            kept = json.loads(self._file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        digests: dict[str, str] = kept.get(self._environment, {})
        return digests


def _digest(module: str) -> str:
    """Of a module's source and of its lines in the list."""
    source = _SOURCES.joinpath(*module.split(".")).with_suffix(".py")
    lines = [" ".join(one) for one in listed() if one.module == module]
    return hashlib.sha256(source.read_bytes() + "\n".join(lines).encode()).hexdigest()
