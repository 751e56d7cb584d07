"""Links between the pages lead somewhere, and nothing is loaded from elsewhere."""

import functools
import re
from pathlib import Path

import pytest

from mazebot.common.files.root import ROOT
from tests.docs.pages import PAGES

LINK = re.compile(r"!?\[(?:[^\[\]]|\[[^\]]*\])*\]\(([^()\s]+)\)")
SITE = (ROOT / "mkdocs.yml").read_text()


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)


def links(page: Path) -> list[str]:
    text = re.sub(r"`[^`\n]*`", "", prose(page))
    return LINK.findall(text)


@functools.cache
def anchors(page: Path) -> frozenset[str]:
    """The anchors of its headings, as GitHub and the site make them."""
    found: dict[str, int] = {}
    made = set()
    for heading in re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        slug = re.sub(r"[^\w\- ]", "", words).strip().replace(" ", "-")
        count = found.get(slug, 0)
        found[slug] = count + 1
        made.add(f"{slug}-{count}" if count else slug)
    return frozenset(made)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_of_a_page_leads_somewhere(page: Path) -> None:
    for link in links(page):
        if link.startswith(("http://", "https://")):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        assert target.exists(), f"{page.name}: {link}: no such file"
        assert target.is_relative_to(ROOT), f"{page.name}: {link}: outside of the repository"
        if anchor:
            assert anchor in anchors(target), f"{page.name}: {link}: no such heading"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pictures_are_in_the_repository(page: Path) -> None:
    assert not re.findall(r"!\[[^\]]*\]\(https?:|<img|<script|^```mermaid", prose(page))


def test_readme_leads_to_every_page() -> None:
    linked = {(ROOT / link.partition("#")[0]).resolve() for link in links(ROOT / "README.md")}
    missing = [page.name for page in PAGES if page not in linked and page.name != "README.md"]
    assert not missing, f"README.md, where to look next: link {missing}"


def test_the_site_has_every_page() -> None:
    listed = set(re.findall(r": ([\w/-]+\.md)$", SITE, re.MULTILINE))
    assert listed == {str(page.relative_to(ROOT)) for page in PAGES}, "mkdocs.yml: nav"


def test_the_site_loads_nothing_from_elsewhere() -> None:
    assert re.search(r"^  font: false$", SITE, re.MULTILINE)
    assert "http" not in SITE


def test_the_messages_of_the_page_are_those_of_the_code() -> None:
    sources = (*(ROOT / "services").rglob("*.py"), ROOT / "docker-compose.yaml")
    code = "\n".join(path.read_text() for path in sources)
    # A text that goes on in the next line of the code is one text.
    code = re.sub(r'"\s*\n\s*f?"', "", code)
    own, _, _ = (ROOT / "docs" / "troubleshooting.md").read_text().partition("\n## Seeing")
    own = own.partition("\n## Starting")[2]
    for row in re.findall(r"^\| ([^|]+) \|", own, re.MULTILINE):
        for message in re.findall(r"`([^`]+)`", row):
            if message.startswith(("ModuleNotFoundError", "session.", "/", "error 20", "NAME")):
                continue
            for part in re.split(r"\.\.\.|[<>]", message):
                words = part.strip(" :;,()?")
                assert len(words) < 4 or words in code, f"{message!r}: {words!r} is not in the code"
