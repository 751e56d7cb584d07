"""The command `mazebot` as a person can paste it into the terminal of this process."""

from __future__ import annotations

import shlex
import shutil
import sys
import sysconfig
from pathlib import Path


def own_command(*words: str | Path) -> str:
    """A command of this installation's `mazebot`: by its name where that is on the path, else by
    its file, seen from the working directory. Words that a shell would take apart are quoted.
    """
    return shlex.join([*_program(), *map(str, words)])


def _program() -> list[str]:
    script = Path(sysconfig.get_path("scripts"), "mazebot")
    if not script.is_file():
        return [sys.executable, "-m", "mazebot.cli"]
    found = shutil.which("mazebot")
    if found is not None and script.samefile(found):
        return ["mazebot"]
    # A name without a folder would be sought on the path.
    here = Path.cwd()
    return [str(script.relative_to(here) if here in script.parent.parents else script)]
