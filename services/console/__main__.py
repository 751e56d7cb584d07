"""Runs the service: `python -m services.console`."""

import sys

from services.console.start import main

main(sys.argv[1:])
