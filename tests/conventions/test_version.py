"""One version, in pyproject.toml: what states it elsewhere agrees."""

import re
import tomllib

import yaml

from mazebot.common.files.root import ROOT
from mazebot.common.files.version import mazebot_version

STATED = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


def test_the_version_is_that_of_pyproject() -> None:
    assert mazebot_version() == STATED


def test_the_newest_heading_of_the_changelog_is_the_version() -> None:
    text = (ROOT / "CHANGELOG.md").read_text()
    headings = re.findall(r"^## \[([\d.]+)\] - \d{4}-\d\d-\d\d$", text, re.MULTILINE)
    assert headings[0] == STATED, "CHANGELOG.md: give the version a heading with its date"
    assert "## [Unreleased]" in text
    assert len(headings) == len(re.findall(r"^## ", text, re.MULTILINE)) - 1


def test_the_citation_names_the_version_and_its_date() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == STATED, "CITATION.cff: version"
    assert f"## [{STATED}] - {citation['date-released']}" in (ROOT / "CHANGELOG.md").read_text()
