"""Runs the router under a guard: `python -m mazebot.router`."""

import sys

from mazebot.router.guard import main

main(sys.argv[1:])
