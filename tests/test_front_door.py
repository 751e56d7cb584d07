"""What a program imports from `mazebot` itself."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import mazebot
from mazebot import plugins
from mazebot.common.files.root import ROOT


@pytest.mark.parametrize("name", mazebot.__all__)
def test_each_public_name_is_the_one_that_type_checkers_see(name: str) -> None:
    tree = ast.parse(Path(mazebot.__file__).read_text())
    told = {
        alias.name: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    module = told[name]
    assert module is not None
    found = getattr(mazebot, name)
    origin = getattr(found, "__module__", None) or found.__name__.rpartition(".")[0]
    assert origin == module
    assert name in dir(mazebot)


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'Sesion'"):
        _ = mazebot.Sesion


def test_importing_it_loads_nothing() -> None:
    script = "import sys, mazebot; print([m for m in sys.modules if m.startswith('mazebot.')])"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_every_example_and_page_imports_from_the_front_door() -> None:
    for path in (
        *(ROOT / "docs").glob("*.md"),
        *(ROOT / "examples").glob("*.py"),
        ROOT / "README.md",
    ):
        for line in path.read_text().splitlines():
            if line.startswith(("from mazebot", "import mazebot")):
                assert line.startswith(("from mazebot import ", "from mazebot.plugins import ")), (
                    f"{path}: {line}"
                )


def test_what_plugins_names_is_there() -> None:
    assert sorted(plugins.__all__) == sorted(name for name in vars(plugins) if name[0].isalpha())
