"""Figures of a process of its own: what other tests have left in this one would blur them."""

from __future__ import annotations

import subprocess
import sys

from mazebot.common.files.root import ROOT


def figures(module: str, call: str, timeout_s: float) -> list[float]:
    """What a call of a function in a module of tests gives, in a new process.

    Raises CalledProcessError where it fails, TimeoutExpired where it takes longer.
    """
    # What it logs is not kept: of thousands of requests, that is much.
    done = subprocess.run(
        [sys.executable, "-c", f"import {module} as tests; print(*tests.{call})"],
        stdout=subprocess.PIPE, text=True, check=True, timeout=timeout_s, cwd=ROOT,
    )  # fmt: skip
    return [float(word) for word in done.stdout.split()]
