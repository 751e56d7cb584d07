"""What tests of the simulation share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.physics.stage import OPEN, Stage


@pytest.fixture
def stage() -> Iterator[Stage]:
    """The open world, running."""
    one = Stage()
    one.load(OPEN)
    yield one
    one.node.close()
