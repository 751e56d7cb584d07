"""Runs the service: `python -m mazebot.console`."""

import sys

from mazebot.console.start import main

main(sys.argv[1:])
