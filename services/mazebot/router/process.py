"""The router's process, which the guard starts."""

import ctypes
import logging
import os
import signal
import sys

from mazebot.common.bus.config import BusConfig
from mazebot.common.config import ConfigError, fail
from mazebot.common.node import log
from mazebot.common.settings.load import load
from mazebot.router.config import RouterConfig
from mazebot.router.router import Router

STOPS = (signal.SIGTERM, signal.SIGINT)
_PR_SET_PDEATHSIG = 1


def main(arguments: list[str]) -> None:
    """Run the router until it receives a stop signal, or its guard ends."""
    # Zenoh's threads inherit the mask, so that the signal is delivered to this thread.
    signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    try:
        config = load(RouterConfig, "router", arguments)
        log.configure()
        router = Router(config, load(BusConfig, "bus", []).prefix)
    except ConfigError as error:
        fail(str(error))
    logging.getLogger("router").info("listening on %s", config.listen)
    signal.sigwait(STOPS)
    router.close()
    sys.stdout.flush()
    # Zenoh's threads have nothing left to do.
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1:])
