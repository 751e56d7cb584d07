"""The pictures of the pages."""

from __future__ import annotations

import pytest

from mazebot.common.files.root import ROOT
from tests.browser.console_pictures import PICTURES

MOST_BYTES = 150_000


@pytest.mark.parametrize("name", PICTURES)
def test_each_picture_of_the_live_page_is_small_and_on_its_page(name: str) -> None:
    assert (ROOT / "docs" / "images" / name).stat().st_size < MOST_BYTES
    assert f"](images/{name})" in (ROOT / "docs" / "console.md").read_text()
