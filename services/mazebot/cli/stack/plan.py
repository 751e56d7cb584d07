"""What a stack consists of: the services, each with its command and environment."""

from __future__ import annotations

import json
import os
import socket
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from mazebot.cli.own_router import router_address, taken
from mazebot.cli.parsing.completion import NAVIGATION, SIMULATOR
from mazebot.common.config import ConfigError
from mazebot.common.settings.known_settings import unknown_name

if TYPE_CHECKING:
    from mazebot.bringup.config import BringupConfig
    from mazebot.recorder.config import RecorderConfig
    from mazebot.worldgen.config import WorldgenConfig

ROUTER, DEMO = "router", "bringup"
"""The services that all others need, and that ends with the tour."""
OPERATOR = "operator"
"""Whose key the user's tools have."""
_MAPPERS, _LOCALIZER = ("mapping", "explorer"), "localization"
_SIMULATOR = ("worldgen", "physics", "spawner", "perception", "recorder", DEMO)
_NAVIGATION = ("navigation", "recorder")
"""And what localises the robot."""
_LOOK_AGAIN_S, _SETTLES_S = 0.3, 5.0
"""Between two looks for who runs on another router, and the longest time for it."""
_VIEWER_PORTS = {
    # As Docker Compose names them.
    "MAZEBOT_VIEWER_PORT": ("MAZEBOT_RECORDER_WEB_PORT", 9090),
    "MAZEBOT_VIEWER_DATA_PORT": ("MAZEBOT_RECORDER_GRPC_PORT", 9876),
}


class ServicePlan(BaseModel):
    """A service to start."""

    name: str
    command: list[str]
    environment: dict[str, str]
    restarts: bool = True
    """Whether it is started again when it has ended."""


class StackPlan(BaseModel):
    """A stack to start."""

    port: int
    """Of its router; without one, it is only the stack's name."""
    about: str
    services: list[ServicePlan]
    connect: str | None = None
    """The endpoint of the router of another stack."""
    left_out: list[str] = []
    """Services that run there already."""
    keys_dir: Path | None = None
    """The folder of the keys with which the services sign in at the router."""

    @property
    def endpoint(self) -> str:
        """Of the router."""
        return self.connect or router_address(self.port)


class StackOptions(BaseModel):
    """The options of `mazebot up`. None: from the environment, or the default."""

    world: str
    port: int
    overrides: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    """Services, or halves of a stack."""
    connect: str | None = None
    """The endpoint of another stack's router, in place of a router of its own."""
    slam: bool = False
    map_file: Path | None = None
    worlds_dir: Path | None = None
    texture_base: Path | None = None
    use_aruco: bool | None = None
    seed: int | None = None
    pace: str | None = None
    camera: bool | None = None
    config: Path | None = None
    keys_dir: Path | None = None


def plan_of(options: StackOptions) -> StackPlan:
    """The stack for some options, checked before anything is started.

    Raises ConfigError where a world, a service or a setting is wrong, or a port is taken.
    """
    names = _names(options)
    key_files = _key_files(options.keys_dir)
    there = (
        _running_on(options.connect, key_files.get(OPERATOR)) if options.connect else frozenset()
    )
    left_out = [name for name in names if name in there]
    names = [name for name in names if name not in there]
    if not names:
        raise ConfigError(f"--connect: {options.connect}: all these services run there already")
    environments = _environments(options)
    plan = StackPlan(
        port=options.port,
        connect=options.connect,
        left_out=left_out,
        keys_dir=None if options.keys_dir is None else options.keys_dir.absolute(),
        about=f"world {options.world}{', without a map' if options.slam else ''}",
        services=[
            ServicePlan(
                name=name,
                command=[sys.executable, "-m", f"mazebot.{name}", *_flags(name, options)],
                environment={
                    **environments["all"],
                    **environments.get(name, {}),
                    **_given(MAZEBOT_BUS_KEY_FILE=key_files.get(name)),
                    **_given(MAZEBOT_RECORDER_FOXGLOVE_KEY_FILE=key_files.get(OPERATOR)),
                },
                restarts=name != DEMO,
            )
            for name in names
        ],
    )
    _check(plan, options)
    return plan


def service_names(text: Sequence[str]) -> tuple[str, ...]:
    """The services, and halves of a stack, that `--only` names, separated by commas or given one by
    one.

    Raises ConfigError for an unknown one.
    """
    names = [name for some in text for name in some.split(",")]
    known = (*known_services(), SIMULATOR, NAVIGATION)
    return tuple(_known("--only", name, known) for name in names)


def known_services() -> tuple[str, ...]:
    """All services of a stack."""
    from mazebot.common.messages.topics import SERVICES  # noqa: PLC0415 - loads the messages

    return (ROUTER, *SERVICES)


def known_service(option: str, name: str) -> str:
    """A service's name. Raises ConfigError where there is no such service."""
    return _known(option, name, known_services())


def _known(option: str, name: str, known: Sequence[str]) -> str:
    if name not in known:
        raise ConfigError(f"{option}: {name!r:.60}: unknown service{unknown_name(name, known)}")
    return name


def _names(options: StackOptions) -> list[str]:
    from mazebot.common.messages.topics import SERVICES  # noqa: PLC0415 - loads the messages

    localizers = _MAPPERS if options.slam else (_LOCALIZER,)
    wanted = set(options.only) or {SIMULATOR, NAVIGATION}
    for half, services in ((SIMULATOR, _SIMULATOR), (NAVIGATION, (*_NAVIGATION, *localizers))):
        if half in wanted:
            wanted |= set(services)
    routers = [] if options.connect else [ROUTER]
    return [*routers, *(name for name in SERVICES if name in wanted)]


def _key_files(folder: Path | None) -> dict[str, Path]:
    """The keys of the services, and of the operator, by name; those that are missing are made.

    Raises ConfigError.
    """
    if folder is None:
        return {}
    # It loads all tables.
    from mazebot.common.access.key_store import KeyStore  # noqa: PLC0415

    store = KeyStore(folder.absolute())
    store.complete()
    return {name: store.path_of(name) for name in store.read()}


def _running_on(endpoint: str, key_file: Path | None) -> frozenset[str]:
    """The services on another stack's router; of one that has just been started, all of them too:
    they are asked for until the answer stays the same. Raises ConfigError where there is none.
    """
    # Zenoh takes long to load.
    from mazebot.common.bus.config import BusConfig  # noqa: PLC0415
    from mazebot.common.bus.liveliness import alive  # noqa: PLC0415
    from mazebot.common.bus.session import BusUnavailableError, join  # noqa: PLC0415
    from mazebot.common.settings.load import load  # noqa: PLC0415

    config = load(BusConfig, "bus", [], {"connect": endpoint, **_given(key_file=key_file)})
    try:
        session, _ = join(config)
    except BusUnavailableError as error:
        raise ConfigError(f"--connect: {error}: must be the router of a stack that runs") from error
    running = frozenset(alive(session, config.keys))
    end_s = time.monotonic() + _SETTLES_S
    while True:
        time.sleep(_LOOK_AGAIN_S)
        before, running = running, frozenset(alive(session, config.keys))
        if running == before or time.monotonic() > end_s:
            break
    session.close()  # type: ignore[no-untyped-call]
    return running


def _flags(name: str, options: StackOptions) -> list[str]:
    return ["--listen", router_address(options.port)] if name == ROUTER else []


def _environments(options: StackOptions) -> dict[str, dict[str, str]]:
    """As in docker-compose.yaml: what is set for all services, and for some."""
    common = {
        "MAZEBOT_BUS_CONNECT": options.connect or router_address(options.port),
        "PYTHONUNBUFFERED": "1",
        **_given(
            MAZEBOT_SEED=options.seed,
            MAZEBOT_BUS_PACE=options.pace,
            MAZEBOT_CONFIG=None if options.config is None else options.config.absolute(),
        ),
    }
    overrides = json.dumps(options.overrides) if options.overrides else None
    drives = not options.only or NAVIGATION in options.only or "navigation" in options.only
    map_file = None if options.map_file is None else options.map_file.absolute()
    recorder = {
        "MAZEBOT_RECORDER_LIVE": os.environ.get("MAZEBOT_RECORDER_LIVE") or "true",
        # In containers only ports on this address are published.
        "MAZEBOT_RECORDER_BIND": os.environ.get("MAZEBOT_RECORDER_BIND") or "127.0.0.1",
        **{
            setting: os.environ[variable]
            for variable, (setting, _) in _VIEWER_PORTS.items()
            if os.environ.get(variable)
        },
    }
    return {
        "all": common,
        ROUTER: _given(MAZEBOT_ROUTER_KEYS_DIR=options.keys_dir and options.keys_dir.absolute()),
        "worldgen": _given(
            MAZEBOT_WORLDGEN_MAP_FILE=map_file,
            MAZEBOT_WORLDGEN_WORLDS_DIR=options.worlds_dir,
            MAZEBOT_WORLDGEN_TEXTURE_BASE=options.texture_base,
        ),
        "physics": _given(MAZEBOT_PHYSICS_CAMERA_ENABLED=options.camera),
        "recorder": recorder,
        DEMO: _given(
            MAZEBOT_BRINGUP_WORLD_NAME=options.world,
            MAZEBOT_BRINGUP_WORLD_OVERRIDES=overrides,
            MAZEBOT_BRINGUP_USE_ARUCO=options.use_aruco,
            MAZEBOT_BRINGUP_SLAM=options.slam or None,
            MAZEBOT_BRINGUP_DRIVE=None if drives else False,
        ),
    }


def _given(**values: object) -> dict[str, str]:
    return {name: str(value) for name, value in values.items() if value is not None}


def _check(plan: StackPlan, options: StackOptions) -> None:
    """Raises ConfigError where a service would refuse its settings, the world cannot be loaded, or
    a port is taken.
    """
    from mazebot.cli.parsing.known import model_of  # noqa: PLC0415
    from mazebot.common.settings.load import load  # noqa: PLC0415

    settings: dict[str, Any] = {}
    for service in plan.services:
        name = service.name
        with _environment(service.environment):
            load(model_of("bus"), "bus", [])
            settings[name] = load(model_of(name), name, service.command[3:])
    if DEMO in settings:
        _check_world(options.world, settings[DEMO], settings.get("worldgen"))
    _check_ports(plan, settings.get("recorder"))


def _check_world(given: str, bringup: BringupConfig, worldgen: WorldgenConfig | None) -> None:
    """Raises ConfigError where the world cannot be loaded."""
    from mazebot.worldgen.config import WorldgenConfig  # noqa: PLC0415
    from mazebot.worldgen.files import is_file  # noqa: PLC0415
    from mazebot.worldgen.recipe.loader import load_world  # noqa: PLC0415
    from mazebot.worldgen.recipe.sources import SHORT_NAMES, known_worlds  # noqa: PLC0415

    config = worldgen or WorldgenConfig()
    known = known_worlds(config.worlds_dir)
    if is_file(given):
        raise ConfigError(
            f"--world: {given!r:.80}: must be a world's name: `mazebot demo` takes files"
        )
    if given not in known and SHORT_NAMES.get(given) not in known:
        names = (*(short for short, name in SHORT_NAMES.items() if name in known), *known)
        raise ConfigError(f"--world: {given!r:.80}: unknown world{unknown_name(given, names)}")
    load_world(
        bringup.world_name,
        bringup.use_aruco,
        config.worlds_dir,
        config.texture_base,
        bringup.world_overrides,
    )
    if bringup.slam and config.map_file is not None:
        raise ConfigError(f"--map: {config.map_file}: must be given without --slam")


def _check_ports(plan: StackPlan, recorder: RecorderConfig | None) -> None:
    """Raises ConfigError where a port is taken."""
    if plan.connect is None and _is_taken(plan.port):
        raise taken(plan.endpoint)
    if recorder is None or not recorder.live:
        return
    ports = (recorder.web_port, recorder.grpc_port)
    for port, variable in zip(ports, _VIEWER_PORTS, strict=True):
        if _is_taken(port):
            raise ConfigError(
                f"recorder: port {port} of the live view is in use: choose another one "
                f"({variable}=N), or none (MAZEBOT_RECORDER_LIVE=false)"
            )


def _is_taken(port: int) -> bool:
    with socket.socket() as probe:
        # As the services do: a connection that has just ended does not count.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return True
    return False


@contextmanager
def _environment(more: Mapping[str, str]) -> Iterator[None]:
    """The environment of a service."""
    before = dict(os.environ)
    os.environ.update(more)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
