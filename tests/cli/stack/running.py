"""Stacks whose services are short programs."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from mazebot.bench.parts.loopback_router import free_port
from mazebot.cli.stack.plan import ServicePlan, StackPlan
from mazebot.cli.stack.state import ServiceState, StackFolder

LASTS = "import time; time.sleep(100)"
DEAF = f"""
import signal
signal.signal(signal.SIGTERM, signal.SIG_IGN)
print("deaf", flush=True)
{LASTS}
"""


def plan_of(restarts: bool = True, **programs: str) -> StackPlan:
    """A stack of services with these programs, on a free port."""
    services = [
        ServicePlan(
            name=name, command=[sys.executable, "-c", program], environment={}, restarts=restarts
        )
        for name, program in programs.items()
    ]
    return StackPlan(port=free_port(), about="world none", services=services)


def says(*lines: str) -> str:
    """A program that says some lines, and lasts."""
    return f"print({chr(10).join(lines)!r}, flush=True); {LASTS}"


def wait_until(holds: Callable[[], object], timeout_s: float = 20.0) -> None:
    """Return as soon as a condition holds. Raises AssertionError where it never does."""
    end_s = time.monotonic() + timeout_s
    while not holds():
        assert time.monotonic() < end_s, "it never came to pass"
        time.sleep(0.02)


def service(folder: StackFolder, name: str) -> ServiceState:
    """The state of a service of a stack that runs."""
    state = folder.running()
    assert state is not None
    found = state.service(name)
    assert found is not None
    return found


@pytest.fixture
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of all stacks of a test."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for name in ("MAZEBOT_BUS_CONNECT", "MAZEBOT_ROUTER_PORT"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path
