"""The stacks that faults are done to: processes of `mazebot up`, or containers."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from contextlib import ExitStack
from pathlib import Path

from mazebot.bench.chaos import machines
from mazebot.bench.chaos.links import Links, Shape
from mazebot.bench.chaos.machines import Machine
from mazebot.bench.parts.loopback_router import free_port, running_router
from mazebot.common.access.grants import OPERATOR
from mazebot.common.bus.config import BusConfig
from mazebot.common.config import ConfigError
from mazebot.common.files.key_file import file_of
from mazebot.common.files.root import ROOT
from mazebot.common.node.node import random_generator

SERVICES = (
    "worldgen", "physics", "spawner", "perception", "localization", "navigation", "recorder",
)  # fmt: skip
EXPLORING = (*(one for one in SERVICES if one != "localization"), "mapping", "explorer")
"""In place of these, where the robot makes its map."""
_COMMAND_S = 300.0
_MACHINES = "machines"
_SQUEEZED_S = 10.0
_SPARE_BYTES, _TAKEN_BYTES = 16_000_000, 48_000_000
"""Left to a service below its limit, and what is taken of it: less than any service has."""
_STARVED_CPUS = "0.25"
"""Of a processor: less than any service of the drive needs, but the router."""


class Stack(ABC):
    """All services of one robot, without a demo."""

    def __init__(
        self, folder: Path, seed: int, explores: bool = False, has_machines: bool = False
    ) -> None:
        """`explores`: without a map, the robot makes one; `has_machines`: what they see
        of their machines can be changed.
        """
        self.port = free_port()
        self.folder = folder
        self.services = EXPLORING if explores else SERVICES
        self._seed = seed
        self._explores = explores
        self._has_machines = has_machines
        self._processes: dict[str, int] = {}
        self._environment = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith("MAZEBOT_") and name != "ROS_DOMAIN_ID"
        }

    @property
    def endpoint(self) -> str:
        """Where its router listens."""
        return f"tcp/127.0.0.1:{self.port}"

    def bus(self, identity: str = OPERATOR) -> BusConfig:
        """How somebody joins its bus."""
        return BusConfig(connect=self.endpoint)

    @property
    def recordings(self) -> Path:
        """The folder that the recorder writes."""
        return self.folder / "recordings"

    @abstractmethod
    def start(self) -> None:
        """Start all services. Raises ConfigError where one does not come up."""

    @abstractmethod
    def stop(self) -> None:
        """End them; recordings are closed."""

    @abstractmethod
    def look(self) -> None:
        """Look for the processes of the services, so that what is done to them is done at once."""

    def kill(self, service: str) -> None:
        """End a service as `kill -9` does; the stack starts it again. Raises ConfigError."""
        self._signal(service, signal.SIGKILL)

    @abstractmethod
    def freeze(self, service: str) -> None:
        """Let a service stand still."""

    @abstractmethod
    def thaw(self, service: str) -> None:
        """Let it go on."""

    def held(self) -> dict[str, tuple[int, float]]:
        """Process and resident memory, MB, of each service that was looked for and still runs."""
        found = {}
        for service, process in self._processes.items():
            with contextlib.suppress(OSError):
                pages = Path(f"/proc/{process}/statm").read_text().split()
                found[service] = process, int(pages[1]) * os.sysconf("SC_PAGESIZE") / 1e6
        return found

    def cut(self, service: str) -> None:
        """Take a service off the network. Raises ConfigError where that cannot be done here."""
        raise ConfigError("processes of one machine have no network between them to be cut")

    def join(self, service: str) -> None:  # noqa: B027 - what cannot be cut is never joined
        """Put it back."""

    def starve(self, service: str) -> None:
        """Leave a service a small part of a processor. Raises ConfigError where that cannot be done
        here.
        """
        raise ConfigError(f"{service}: only a container can be kept from the processor")

    def feed(self, service: str) -> None:  # noqa: B027 - see starve
        """Give it back."""

    def squeeze(self, service: str) -> None:
        """Let a service reach its memory limit, and return when the kernel has ended it. Raises
        ConfigError where that cannot be done here.
        """
        raise ConfigError(f"{service}: only a container has a memory limit")

    def alter(self, service: str, machine: Machine) -> None:
        """Change what a service sees of its machine; an empty name stands for all. Raises
        ConfigError where that cannot be done here.
        """
        raise ConfigError(f"{service or 'all'}: the machine cannot be changed here")

    def restore(self, service: str) -> None:  # noqa: B027 - see alter
        """Take that back."""

    def hold_back(self, service: str) -> None:
        """End all services, and start them again in another order, without this one. Raises
        ConfigError where that cannot be done here.
        """
        raise ConfigError(f"{service}: only containers are started one by one")

    def release(self, service: str) -> None:  # noqa: B027 - see hold_back
        """Start it, too."""

    def shape(self, service: str, shape: Shape) -> None:
        """Change how the links of a service pass on what they get; an empty name stands for all
        services. Raises ConfigError where that cannot be done here.
        """
        raise ConfigError(f"{service or 'all'}: there is no proxy on the links")

    def unshape(self, service: str) -> None:  # noqa: B027 - what has no shape keeps none
        """Take the shape back."""

    def restart(self) -> None:
        """End every service at once, as `kill -9` does."""
        for service in (*self.services, "router"):
            self.kill(service)

    def _signal(self, service: str, number: signal.Signals) -> None:
        process = self._processes.get(service)
        if process is None:
            raise ConfigError(f"{service}: does not run")
        try:
            os.kill(process, number)
        except PermissionError as error:
            raise ConfigError("a container's process can be killed by root alone") from error
        except ProcessLookupError as error:
            raise ConfigError(f"{service}: has ended by itself") from error

    def _run(self, *command: str) -> str:
        done = subprocess.run(
            command, cwd=self.folder, env=self._environment, capture_output=True,
            text=True, timeout=_COMMAND_S, check=False,
        )  # fmt: skip
        if done.returncode:
            said = (done.stderr.strip() or done.stdout.strip()).splitlines()
            raise ConfigError(f"{' '.join(command[:4])}: {said[-1] if said else done.returncode}")
        return done.stdout


class ProcessStack(Stack):
    """The services that `mazebot up` starts, each in a process."""

    def __init__(
        self, folder: Path, seed: int, explores: bool = False, has_machines: bool = False
    ) -> None:
        super().__init__(folder, seed, explores, has_machines)
        self._machine = folder / _MACHINES
        self._environment |= {
            "MAZEBOT_ROUTER_PORT": str(self.port),
            "MAZEBOT_RECORDER_RECORDINGS_DIR": str(self.recordings),
            "MAZEBOT_VIEWER_PORT": str(free_port()),
            "MAZEBOT_VIEWER_DATA_PORT": str(free_port()),
            "XDG_RUNTIME_DIR": str(folder),
        }

    def start(self) -> None:
        """See Stack."""
        if self._has_machines:
            machines.set_machine(self._machine, Machine())
            library = machines.compile_library(self.folder)
            self._environment |= machines.variables(str(library), str(self._machine))
        self._up(*(("--slam",) if self._explores else ()))

    def alter(self, service: str, machine: Machine) -> None:
        """See Stack. All have one machine."""
        if service:
            super().alter(service, machine)
        machines.set_machine(self._machine, machine)
        machines.check(self._run(sys.executable, "-c", machines.SHOW), machine, "all")

    def restore(self, service: str) -> None:
        """See Stack."""
        machines.set_machine(self._machine, Machine())

    def _up(self, *options: str) -> None:
        only = ",".join(self.services)
        self._mazebot("up", "--detach", "--only", only, "--seed", str(self._seed), *options)

    def stop(self) -> None:
        """See Stack."""
        self._mazebot("down")

    def freeze(self, service: str) -> None:
        """See Stack."""
        self._signal(service, signal.SIGSTOP)

    def thaw(self, service: str) -> None:
        """See Stack."""
        self._signal(service, signal.SIGCONT)

    def look(self) -> None:
        """See Stack."""
        services = json.loads(self._mazebot("ps", "--json"))
        self._processes = {one["service"]: one["pid"] for one in services if one["pid"]}
        if "router" in self._processes:
            # The process that the others talk to is the child of the one that watches it.
            self._processes["router"] = _child(self._processes["router"])

    def _mazebot(self, *arguments: str) -> str:
        return self._run(sys.executable, "-m", "mazebot.cli", *arguments)


class LinkedStack(ProcessStack):
    """Processes with a proxy between them and their router."""

    def __init__(self, folder: Path, seed: int) -> None:
        super().__init__(folder, seed)
        # Of `mazebot ps` and `down`: the router is not theirs.
        self._environment["MAZEBOT_ROUTER_PORT"] = str(free_port())
        self._open = ExitStack()
        self._links = Links(self.port, seed)

    def start(self) -> None:
        """See Stack."""
        try:
            self._open.enter_context(running_router(self.port))
            self._open.enter_context(self._links)
        except TimeoutError as error:
            raise ConfigError(str(error)) from error
        self._up("--connect", f"tcp/127.0.0.1:{self._links.port}")

    def stop(self) -> None:
        """See Stack."""
        super().stop()
        self._open.close()

    def shape(self, service: str, shape: Shape) -> None:
        """See Stack."""
        if service and service not in self._links.services():
            raise ConfigError(f"{service}: has no link to the router")
        self._links.shape(service, shape)

    def unshape(self, service: str) -> None:
        """See Stack."""
        self._links.clear(service)


class ContainerStack(Stack):
    """Containers of Docker Compose, in a project of their own."""

    def __init__(
        self, folder: Path, seed: int, explores: bool = False, has_machines: bool = False
    ) -> None:
        super().__init__(folder, seed, explores, has_machines)
        self._project = f"mazebot-chaos-{self.port}"
        self._order = random_generator(seed, "chaos/start")
        self._environment |= {
            "COMPOSE_PROJECT_NAME": self._project,
            "MAZEBOT_ROUTER_PORT": str(self.port),
            "MAZEBOT_VIEWER_PORT": str(free_port()),
            "MAZEBOT_VIEWER_DATA_PORT": str(free_port()),
            "MAZEBOT_FOXGLOVE_PORT": str(free_port()),
            "SEED": str(seed),
        }

    def bus(self, identity: str = OPERATOR) -> BusConfig:
        """See Stack."""
        key_file = file_of(self.folder / "keys", identity)
        return BusConfig(connect=self.endpoint, key_file=key_file)

    def start(self) -> None:
        """See Stack."""
        (self.folder / "docker-compose.yaml").write_bytes(
            (ROOT / "docker-compose.yaml").read_bytes()
        )
        for name in ("worlds", "recordings"):
            link = self.folder / name
            if name == "worlds" and not link.exists():
                link.symlink_to(ROOT / name)
            link.mkdir(exist_ok=True)
        if self._has_machines:
            self._make_machines()
        self._compose("--profile", self._profile, "up", "--detach", "router", *self.services)
        key_file = file_of(self.folder / "keys", OPERATOR)
        end_s = time.monotonic() + _COMMAND_S
        while not key_file.exists():
            if time.monotonic() > end_s:
                raise ConfigError(f"{key_file}: the router has made no key")
            time.sleep(0.1)

    def stop(self) -> None:
        """See Stack."""
        self._compose("--profile", self._profile, "down", "--volumes")

    def look(self) -> None:
        """See Stack. `docker kill` would keep a container from being started again."""
        for service in (*self.services, "router"):
            process = self._run(
                "docker", "inspect", "--format", "{{.State.Pid}}", self._container(service)
            )
            # Below the container's init.
            self._processes[service] = _child(int(process))
        self._processes["router"] = _child(self._processes["router"])

    def freeze(self, service: str) -> None:
        """See Stack."""
        self._run("docker", "pause", self._container(service))

    def thaw(self, service: str) -> None:
        """See Stack."""
        self._run("docker", "unpause", self._container(service))

    def cut(self, service: str) -> None:
        """See Stack."""
        self._run("docker", "network", "disconnect", self._network, self._container(service))

    def join(self, service: str) -> None:
        """See Stack."""
        self._run(
            "docker", "network", "connect", "--alias", service, self._network,
            self._container(service),
        )  # fmt: skip

    def starve(self, service: str) -> None:
        """See Stack."""
        self._run("docker", "update", "--cpus", _STARVED_CPUS, self._container(service))

    def feed(self, service: str) -> None:
        """See Stack."""
        everything = str(os.cpu_count() or 1)
        self._run("docker", "update", "--cpus", everything, self._container(service))

    def squeeze(self, service: str) -> None:
        """See Stack. What is left below the limit is taken by a smaller process beside it."""
        container, process = self._container(service), self._processes[service]
        before = self._run("docker", "inspect", "--format", "{{.HostConfig.Memory}}", container)
        self._limit_memory(container, str(_own_bytes(process) + _SPARE_BYTES))
        takes = f"taken = b'x' * {_TAKEN_BYTES}; import time; time.sleep(60)"
        try:
            self._run("docker", "exec", "--detach", container, "python", "-c", takes)
            end_s = time.monotonic() + _SQUEEZED_S
            while Path(f"/proc/{process}").exists():
                if time.monotonic() > end_s:
                    raise ConfigError(f"{service}: was not ended at its memory limit")
                time.sleep(0.01)
        finally:
            self._limit_memory(container, before.strip())

    def _limit_memory(self, container: str, limit_bytes: str) -> None:
        limits = "--memory", limit_bytes, "--memory-swap", limit_bytes
        end_s = time.monotonic() + _SQUEEZED_S
        while True:
            try:
                self._run("docker", "update", *limits, container)
                return
            except ConfigError:
                # Between its end and its next start a container cannot be changed.
                if time.monotonic() > end_s:
                    raise
                time.sleep(0.1)

    def _make_machines(self) -> None:
        folder = self.folder / _MACHINES
        folder.mkdir()
        library = machines.compile_library(folder)
        services = {}
        for service in (*self.services, "router"):
            machines.set_machine(folder / service, Machine())
            services[service] = {
                "environment": machines.variables(
                    f"/{_MACHINES}/{library.name}", f"/{_MACHINES}/{service}"
                ),
                "volumes": [f"./{_MACHINES}:/{_MACHINES}:ro"],
            }
        # Compose reads it beside the other.
        (self.folder / "docker-compose.override.yaml").write_text(
            json.dumps({"services": services}), encoding="utf-8"
        )

    def alter(self, service: str, machine: Machine) -> None:
        """See Stack."""
        for one in self._with_machine(service):
            machines.set_machine(self.folder / _MACHINES / one, machine)
            shown = self._run("docker", "exec", self._container(one), "python", "-c", machines.SHOW)
            machines.check(shown, machine, one)

    def restore(self, service: str) -> None:
        """See Stack."""
        for one in self._with_machine(service):
            machines.set_machine(self.folder / _MACHINES / one, Machine())

    def _with_machine(self, service: str) -> tuple[str, ...]:
        return (service,) if service else (*self.services, "router")

    def hold_back(self, service: str) -> None:
        """See Stack."""
        everyone = [self._container(one) for one in (*self.services, "router")]
        self._run("docker", "kill", *everyone)
        order = self._order.permutation(len(everyone))
        others = [everyone[i] for i in order if everyone[i] != self._container(service)]
        self._run("docker", "start", *others)

    def release(self, service: str) -> None:
        """See Stack."""
        self._run("docker", "start", self._container(service))

    @property
    def _profile(self) -> str:
        return "slam" if self._explores else "enhanced"

    @property
    def _network(self) -> str:
        return f"{self._project}_bus"

    def _container(self, service: str) -> str:
        return f"{self._project}-{service}-1"

    def _compose(self, *arguments: str) -> str:
        return self._run("docker", "compose", *arguments)


def _own_bytes(process: int) -> int:
    """Memory that a process shares with no file and nobody. Raises ConfigError."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
        (line,) = (line for line in status.splitlines() if line.startswith("RssAnon:"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"process {process} has ended by itself") from error
    return int(line.split()[1]) * 1024


def _child(process: int) -> int:
    """The first child of a process. Raises ConfigError where it has none."""
    try:
        children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
        return int(children[0])
    except (OSError, IndexError) as error:
        raise ConfigError(f"process {process} has ended by itself") from error
