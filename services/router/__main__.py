"""Runs the router under a guard: `python -m services.router`."""

import sys

from services.router.guard import main

main(sys.argv[1:])
