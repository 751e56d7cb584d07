"""A mission: drive round the locations of a world, and report how each drive ended.

    python examples/patrol.py                    # a simulation of its own, as fast as possible
    python examples/patrol.py --connect          # the robot of a running stack

docs/navigator.md lists the methods of `Navigator`: they are those of nav2_simple_commander.
"""

from __future__ import annotations

import argparse
import sys

from mazebot import ConfigError, Navigator, Session, TaskResult


def patrol(navigator: Navigator, rounds: int) -> int:
    """Drive to every location of the world in turn; returns how many drives failed."""
    navigator.waitUntilNav2Active()
    places = navigator.locations()
    if not places:
        raise ConfigError("the world has no locations to drive to")
    failed = 0
    for number in range(rounds):
        for name, place in places.items():
            if not navigator.goToPose(place):
                code, reason = navigator.getTaskError()
                print(f"round {number + 1}: {name}: rejected: {code} {reason}")
                failed += 1
                continue
            while not navigator.isTaskComplete():
                pass  # getFeedback() has the distance that is left
            result = navigator.getResult()
            print(f"round {number + 1}: {name}: {result.name}")
            failed += result != TaskResult.SUCCEEDED
    return failed


def main() -> None:
    """Read the options and drive."""
    parser = argparse.ArgumentParser(description="Patrol the locations of a world.")
    parser.add_argument("--rounds", type=_rounds, default=1, help="at least 1 [default: 1]")
    parser.add_argument("--world", default="original")
    parser.add_argument("--connect", action="store_true", help="drive the robot of a running stack")
    options = parser.parse_args()
    try:
        if options.connect:
            with Navigator.connect() as navigator:
                failed = patrol(navigator, options.rounds)
        else:
            with Session(options.world, camera=False) as session:
                failed = patrol(Navigator.in_process(session), options.rounds)
    except (ConfigError, TimeoutError) as error:
        # A world that does not exist, no stack, a robot that does not get ready.
        sys.exit(f"error: {error}")
    sys.exit(1 if failed else 0)


def _rounds(text: str) -> int:
    """Raises ArgumentTypeError for what is no number of rounds."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: must be a whole number of at least 1")
    return int(text)


if __name__ == "__main__":
    main()
