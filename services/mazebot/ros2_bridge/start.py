"""The service from its flags and environment to its end."""

from __future__ import annotations

import logging
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path

import zenoh

from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import BusUnavailableError, key_of, open_session
from mazebot.common.config import ConfigError, fail
from mazebot.common.files.key_file import Key
from mazebot.common.node.log import RosFormatter
from mazebot.common.settings.load import load
from mazebot.common.stop_signals import on_stop
from mazebot.ros2_bridge.config import NAME, Ros2BridgeConfig
from mazebot.ros2_bridge.dds import Dds, prepare_environment

_BUILT_FOR = Path(sys.prefix) / "share" / "mazebot_distro"
"""Written by docker/ros2/Dockerfile."""
PERIOD_S = 1.0
"""Of looking for another key, and for a router."""


def main(arguments: Sequence[str]) -> None:
    """Carry messages until SIGTERM or SIGINT. A wrong setting ends it with one line and exit code
    2.
    """
    handler = logging.StreamHandler(sys.stdout)
    handler.setFormatter(RosFormatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    try:
        config = load(Ros2BridgeConfig, NAME, arguments)
        bus_config = load(BusConfig, "bus", [])
        _check(bus_config)
    except ConfigError as error:
        fail(str(error))
    with tempfile.TemporaryDirectory() as folder:
        prepare_environment(config.discovery, Path(folder))
        run(config, bus_config)


def _check(bus_config: BusConfig) -> None:
    """Raises ConfigError where the messages that are installed are not those of the bus."""
    built_for = _BUILT_FOR.read_text().strip()
    if bus_config.wire != "rmw_zenoh":
        raise ConfigError(f"bus: wire: {bus_config.wire}: the bridge needs rmw_zenoh")
    if bus_config.distro != built_for:
        raise ConfigError(
            f"bus: distro: {bus_config.distro}: the bridge's image was built for {built_for}; "
            f"build it with --build-arg DISTRO={bus_config.distro}"
        )


def run(config: Ros2BridgeConfig, bus_config: BusConfig) -> None:
    """Carry messages until SIGTERM or SIGINT."""
    # Loads all types.
    from mazebot.ros2_bridge.bridge import Bridge  # noqa: PLC0415

    log = logging.getLogger(NAME)
    keys = bus_config.keys
    domain_id = keys.domain_id if config.domain_id is None else config.domain_id
    stopped = threading.Event()
    on_stop(lambda *_: stopped.set())
    name = keys.whole_name(NAME)
    sides = Dds(domain_id, name), Dds(domain_id, f"{name}_of_other_types")
    threads = [threading.Thread(target=_spin, args=(each, stopped)) for each in sides]
    for thread in threads:
        thread.start()
    while not stopped.is_set():
        key, session = _session(bus_config, stopped)
        if session is None:
            break
        bridge = Bridge(session, keys, config, *sides)
        log.info("carries %s and DDS domain %d", bus_config.connect, domain_id)
        while not stopped.wait(PERIOD_S) and key_of(bus_config) == key:
            pass
        bridge.close()
        session.close()  # type: ignore[no-untyped-call]
    failed = not all(thread.is_alive() for thread in threads)
    for each in sides:
        each.stop()
    for thread in threads:
        thread.join()
    if failed:
        sys.exit(1)


def _spin(dds: Dds, stopped: threading.Event) -> None:
    """Work until it is stopped; an error ends the service, which its supervisor starts again."""
    try:
        dds.spin()
    except Exception:
        logging.getLogger(NAME).exception("DDS")
        stopped.set()


def _session(
    bus_config: BusConfig, stopped: threading.Event
) -> tuple[Key | None, zenoh.Session | None]:
    """A session with the router, which is waited for, and its key; None: it was stopped before."""
    told = ""
    while not stopped.is_set():
        try:
            key = key_of(bus_config)
            return key, open_session(bus_config)
        except BusUnavailableError as error:
            if str(error) != told:
                told = str(error)
                logging.getLogger(NAME).warning("%s; waiting for it", told)
            stopped.wait(PERIOD_S)
    return None, None
