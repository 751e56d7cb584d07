"""Collections wait for the end of the start, and never longer."""

import gc

import pytest

from mazebot.common.garbage import collections_held_off, settled


def test_collections_begin_when_the_work_has_settled_and_leave_out_what_there_is() -> None:
    frozen = gc.get_freeze_count()
    with collections_held_off():
        assert not gc.isenabled()
        settled()
        assert gc.isenabled()
        assert gc.get_freeze_count() > frozen
    gc.unfreeze()
    assert gc.isenabled()


def test_a_start_that_fails_leaves_collections_as_they_were() -> None:
    with pytest.raises(ValueError, match="no world"), collections_held_off():
        raise ValueError("no world")
    assert gc.isenabled()
    settled()
    assert gc.get_freeze_count() == 0
