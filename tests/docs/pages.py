"""The pages a person reads, and the code and commands in them."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from mazebot.common.files.root import ROOT

PAGES = (
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "examples").glob("*.md")),
)


@dataclass(frozen=True)
class Example:
    """A block of code, or one command, and where it stands."""

    page: Path
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.page.name}:{self.line}"


def blocks(*languages: str) -> list[Example]:
    """The fenced blocks in these languages, `""` for none."""
    found = []
    for page in PAGES:
        text = page.read_text()
        for match in re.finditer(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
            if match[1] in languages:
                line = text.count("\n", 0, match.start()) + 2
                found.append(Example(page, line, match[2]))
    return found


def commands() -> list[Example]:
    """Every command line in the pages: one in a block for the shell each."""
    found = []
    for block in blocks("", "sh", "bash"):
        lines = block.text.replace("\\\n", "  ").splitlines()
        for number, line in enumerate(lines):
            words = [
                word for word in shlex.split(line, comments=True) if "=" not in word or "-" in word
            ]
            if words and words[0].removeprefix(".venv/bin/") in PROGRAMS:
                found.append(Example(block.page, block.line + number, line.strip()))
    return found


PROGRAMS = {"mazebot", "make", "docker", "python", "source"}
