"""Runs the router: `python -m services.router`."""

import logging
import os
import signal
import sys

from services.common import log
from services.common.bus import BusConfig
from services.common.config import ConfigError, fail, load
from services.router.config import RouterConfig
from services.router.router import Router

STOPS = (signal.SIGTERM, signal.SIGINT)

# Zenoh's threads inherit the mask, so that the signal comes to this one.
signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
try:
    config = load(RouterConfig, "router", sys.argv[1:])
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
