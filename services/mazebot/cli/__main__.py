"""Runs the command: `python -m mazebot.cli`."""

from mazebot.cli.app import main

main()
