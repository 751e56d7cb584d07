"""The router's process, which the guard starts."""

import ctypes
import logging
import os
import signal
import sys
import time

from mazebot.common.bus.config import BusConfig
from mazebot.common.config import ConfigError, fail
from mazebot.common.node import log
from mazebot.common.resident import give_back_freed
from mazebot.common.settings.load import load
from mazebot.router.config import RouterConfig
from mazebot.router.router import Router
from mazebot.router.stopping import STOPS, stop_came

KEYS_PERIOD_S = 0.5
"""Within this time a new key opens, and a revoked one is refused."""
GIVE_BACK_PERIOD_S = 5.0
"""Zenoh holds messages for slow readers, and their memory after that."""
_PR_SET_PDEATHSIG = 1


def main(arguments: list[str]) -> None:
    """Run the router until it receives a stop signal, or its guard ends."""
    # Zenoh's threads inherit the mask, so that the signal is delivered to this thread.
    signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    try:
        config = load(RouterConfig, "router", arguments)
        log.configure()
        router = Router(config, load(BusConfig, "bus", []).keys)
        logging.getLogger("router").info("listening on %s", config.listen)
        given_s = time.monotonic()
        while not stop_came(KEYS_PERIOD_S):
            router.take_new_keys()
            if time.monotonic() - given_s > GIVE_BACK_PERIOD_S:
                given_s = time.monotonic()
                give_back_freed()
    except ConfigError as error:
        fail(str(error))
    router.close()
    sys.stdout.flush()
    # Zenoh's threads have nothing left to do.
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1:])
