"""Whatever is in a file, what reads it reads it or refuses it in one line."""

from __future__ import annotations

import os
import random
import re
import subprocess
import sys
from pathlib import Path

import pytest

from mazebot.bench.fuzz.mutations import mutated
from mazebot.common.config import ConfigError
from mazebot.common.files.root import ROOT
from tests.fuzz.readers import READERS, Reader
from tests.fuzz.trial import Trial

of_each = pytest.mark.parametrize("reader", READERS, ids=[reader.name for reader in READERS])


@of_each
def test_examples_are_read_and_changed_ones_are_too_or_refused_in_one_line(
    reader: Reader, tmp_path: Path
) -> None:
    trial = Trial(reader, tmp_path / "files", tmp_path / "found")
    examples, refused = list(reader.examples()), 0
    for data in examples:
        assert trial.read(data) == ""
        refused += trial.refused
    # Otherwise no change would get beyond the first line.
    assert refused < len(examples)
    rng = random.Random(reader.name)
    for _ in range(5):
        assert trial.read(mutated(rng.choice(examples), examples, rng)) == ""


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_no_file_that_is_led_further_and_further_ends_in_a_traceback(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", "--files", "150", "--found", str(tmp_path / "found")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        # So that the same files are read each time.
        env={**os.environ, "PYTHONHASHSEED": "0"},
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert len(re.findall(r"^\w+: 15\d files in", done.stdout, re.MULTILINE)) == len(READERS)
    if "CI" in os.environ:
        assert "atheris is not installed" not in done.stdout


@pytest.mark.parametrize(
    ("error", "fault"),
    [
        (KeyError("x"), r"KeyError \(test_files.py:\d+\)"),
        (ConfigError(f"x.yaml: {2000 * 'x'}"), "AssertionError"),
        (ConfigError(""), "AssertionError"),
        (ConfigError("x.yaml: must be a number"), ""),
    ],
)
def test_all_but_one_line_is_a_fault_and_its_file_is_kept_once(
    error: Exception, fault: str, tmp_path: Path
) -> None:
    def fails(_: Path) -> None:
        raise error

    trial = Trial(Reader("kind", "a.txt", fails), tmp_path / "files", tmp_path / "found")
    for data in (b"first", b"second"):
        assert re.match(fault, trial.read(data))
        assert bool(trial.read(data)) == bool(fault)
    kept = list((tmp_path / "found").glob("*.bin")) if fault else []
    assert [file.read_bytes() for file in kept] == ([b"first"] if fault else [])
