"""A stack of containers of its own: own folder, own project, own ports."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import zenoh

from mazebot.bench.parts.loopback_router import free_port
from mazebot.common.access.grants import OPERATOR
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import open_session
from mazebot.common.files.key_file import file_of
from mazebot.common.files.root import ROOT

SERVICES = (
    "router",
    "worldgen",
    "physics",
    "spawner",
    "perception",
    "localization",
    "navigation",
    "recorder",
)
DEMOS = {"original": "demo-world", "enhanced": "demo-world-enhanced"}
OPEN = {"COMPOSE_FILE": "docker-compose.yaml:docker/open.yaml"}
"""Settings of a stack that lets everyone in without a key."""
PROFILES = ("--profile", "original", "--profile", "enhanced")
SOCKET = Path("/var/run/docker.sock")


def wait_until(condition: Callable[[], bool], deadline_s: float, what: str) -> float:
    """Seconds until `condition` held.

    Raises AssertionError where it does not before the deadline.
    """
    start_s = time.monotonic()
    while True:
        asked_s = time.monotonic()
        if condition():
            return time.monotonic() - start_s
        answered_s = time.monotonic()
        waited_s = answered_s - start_s
        assert waited_s < deadline_s, f"not within {deadline_s:g} s: {what}"
        # Asking must not take the processor from what is waited for.
        time.sleep(min(max(0.02, 3.0 * (answered_s - asked_s)), 0.5))


class Stack:
    """Docker Compose, as a person of `uid` uses it in a folder of theirs."""

    def __init__(self, folder: Path, project: str, uid: int, settings: dict[str, str]) -> None:
        self.folder = folder
        self.uid = uid
        self.router_port, self.viewer_port, self.data_port = free_port(), free_port(), free_port()
        self.foxglove_port = free_port()
        self.console_port = free_port()
        self._environment = {
            "PATH": os.environ["PATH"],
            "HOME": str(folder),
            "COMPOSE_PROJECT_NAME": project,
            **settings,
        }
        self._as_person: tuple[str, ...] = ()
        if uid != os.getuid():
            group = str(SOCKET.stat().st_gid)
            ids = ("--reuid", str(uid), "--regid", str(uid), "--groups", group)
            self._as_person = ("setpriv", *ids)
        self._foreground: list[subprocess.Popen[bytes]] = []

    @property
    def project(self) -> str:
        """Its name for Compose."""
        return self._environment["COMPOSE_PROJECT_NAME"]

    @property
    def endpoint(self) -> str:
        """Where the stack's router listens."""
        return f"tcp/127.0.0.1:{self.router_port}"

    @property
    def signs_in(self) -> dict[str, str]:
        """What a tool's environment must say, where it is asked for a key: the operator's."""
        is_open = "docker/open.yaml" in self._environment.get("COMPOSE_FILE", "")
        path = file_of(self.folder / "keys", OPERATOR)
        return {} if is_open else {"MAZEBOT_BUS_KEY_FILE": str(path)}

    def session(self, timeout_s: float = 5.0) -> zenoh.Session:
        """A session on the stack's bus, as the operator."""
        key = self.signs_in.get("MAZEBOT_BUS_KEY_FILE")
        key_file = Path(key) if key else None
        if key_file:
            wait_until(key_file.exists, timeout_s, "the operator's key")
        return open_session(BusConfig(connect=self.endpoint, key_file=key_file), timeout_s)

    @property
    def _settings(self) -> dict[str, str]:
        return self._environment | {
            "MAZEBOT_ROUTER_PORT": str(self.router_port),
            "MAZEBOT_VIEWER_PORT": str(self.viewer_port),
            "MAZEBOT_VIEWER_DATA_PORT": str(self.data_port),
            "MAZEBOT_CONSOLE_PORT": str(self.console_port),
            "MAZEBOT_FOXGLOVE_PORT": str(self.foxglove_port),
        }

    @property
    def recordings(self) -> Path:
        """The folder that the recorder writes."""
        return self.folder / "recordings"

    def compose(
        self, *arguments: str, timeout_s: float = 120.0, settings: dict[str, str] | None = None
    ) -> subprocess.CompletedProcess[str]:
        """Run `docker compose` to its end, with some settings for this time alone; its output and
        its errors are both in `stdout`.
        """
        return subprocess.run(
            [*self._as_person, "docker", "compose", *arguments],
            cwd=self.folder,
            env=self._settings | (settings or {}),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=timeout_s,
            check=False,
        )

    def shell(self, line: str, timeout_s: float = 60.0) -> subprocess.CompletedProcess[str]:
        """Run a line of a shell in the stack's folder to its end."""
        return subprocess.run(
            [*self._as_person, "sh", "-c", line],
            cwd=self.folder,
            env=self._settings,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=timeout_s,
            check=False,
        )

    def in_foreground(self, output: IO[bytes], *arguments: str) -> subprocess.Popen[bytes]:
        """Start `docker compose` as a person who watches it does."""
        process = subprocess.Popen(
            [*self._as_person, "docker", "compose", *arguments],
            cwd=self.folder,
            env=self._settings,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        self._foreground.append(process)
        return process

    def containers(self) -> list[str]:
        """Names of the services that have a container, running or not."""
        service = '{{.Label "com.docker.compose.service"}}'
        return sorted(self._listed("--format", service).split())

    def logs(self, service: str) -> str:
        """What a service has said."""
        return docker("logs", self._identity(service)).stdout

    def inspect(self, service: str) -> dict[str, Any]:
        """What the engine knows of a service's container."""
        (answer,) = json.loads(docker("inspect", self._identity(service)).stdout)
        assert isinstance(answer, dict)
        return answer

    def networks_of(self, service: str) -> list[str]:
        """Names of the networks that a service is in."""
        return sorted(self.inspect(service)["NetworkSettings"]["Networks"])

    def _identity(self, service: str) -> str:
        label = f"label=com.docker.compose.service={service}"
        identity = self._listed("--quiet", "--filter", label).strip()
        assert identity, f"{service} has no container"
        return identity

    def _listed(self, *options: str) -> str:
        """What `docker ps` says of all containers, in a tenth of the time of Compose's own."""
        project = f"label=com.docker.compose.project={self.project}"
        return docker("ps", "--all", "--filter", project, *options).stdout

    def inside(self, service: str, code: str) -> str:
        """What a piece of Python prints in a service's container."""
        return docker("exec", self._identity(service), "python", "-c", code).stdout.strip()

    def status_of_process(self, service: str) -> dict[str, str]:
        """/proc/PID/status of the service itself, below its init."""
        init = self.inspect(service)["State"]["Pid"]
        children = Path(f"/proc/{init}/task/{init}/children").read_text().split()
        assert len(children) == 1, f"{service}: {children}"
        (pid,) = children
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        return dict(line.replace(":\t", ":").split(":", 1) for line in lines)

    def kill(self, service: str) -> float:
        """Kill -9 the service itself, not its container; the monotonic time when it was done."""
        status = self.status_of_process(service)
        try:
            os.kill(int(status["Pid"]), signal.SIGKILL)
        except PermissionError:
            inner = status["NSpid"].split()[-1]
            self.inside(service, f"import os; os.kill({inner}, 9)")
        return time.monotonic()

    def down(self) -> float:
        """`docker compose down`; the seconds that it took."""
        start_s = time.monotonic()
        ended = self.compose("down")
        taken_s = time.monotonic() - start_s
        assert ended.returncode == 0, ended.stdout
        return taken_s

    def clear(self) -> None:
        """Leave nothing behind."""
        self.compose("down", "--timeout", "0", "--volumes")
        for process in self._foreground:
            process.kill()
            process.wait()


@contextmanager
def stack_of(uid: int, settings: dict[str, str] | None = None) -> Iterator[Stack]:
    """A stack in a fresh clone that belongs to `uid`, as far as Compose looks at one."""
    folder = Path(tempfile.mkdtemp(prefix="mazebot-test-"))
    folder.chmod(0o755)
    project = folder.name.lower().replace("_", "-")
    (folder / "docker").mkdir()
    for name in (
        ".env",
        "docker-compose.yaml",
        "docker/open.yaml",
        "docker/tls.yaml",
        "docker/join.yaml",
    ):
        shutil.copy(ROOT / name, folder / name)
    shutil.copytree(ROOT / "worlds", folder / "worlds")
    (folder / "recordings").mkdir()
    shutil.copy(ROOT / "recordings" / ".gitkeep", folder / "recordings" / ".gitkeep")
    if uid != os.getuid():
        for path in (folder, *folder.rglob("*")):
            os.chown(path, uid, uid)
    stack = Stack(folder, project, uid, settings or {})
    try:
        yield stack
    finally:
        stack.clear()
        shutil.rmtree(folder)


def inspect_network(name: str) -> dict[str, Any]:
    """What the engine knows of a network."""
    (answer,) = json.loads(docker("network", "inspect", name).stdout)
    assert isinstance(answer, dict)
    return answer


def docker(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run `docker` to its end, which must be a good one."""
    return subprocess.run(
        ["docker", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
        check=True,
    )
