"""A mission: drive round the locations of a world, and report how each drive ended.

    python examples/patrol.py                    # a simulation of its own, as fast as possible
    python examples/patrol.py --connect          # the robot of a running stack

docs/navigator.md lists the methods of `Navigator`: they are those of nav2_simple_commander.
"""

from __future__ import annotations

import argparse
import sys

from mazebot import Navigator, Session, TaskResult


def patrol(navigator: Navigator, rounds: int) -> int:
    """Drive to every location of the world in turn; returns how many drives failed."""
    navigator.waitUntilNav2Active()
    places = navigator.locations()
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
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--world", default="original")
    parser.add_argument("--connect", action="store_true", help="drive the robot of a running stack")
    options = parser.parse_args()
    if options.connect:
        with Navigator.connect() as navigator:
            failed = patrol(navigator, options.rounds)
    else:
        with Session(options.world, camera=False) as session:
            failed = patrol(Navigator.in_process(session), options.rounds)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
