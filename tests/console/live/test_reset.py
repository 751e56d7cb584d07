"""What a reset from the page does to a tour that has ended, and to its recording."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest

from mazebot.common.recordings.run_folder import REPORT, is_recording
from mazebot.embedded.demo import DemoOptions
from mazebot.recorder.keeping.repair import Rewriting
from tests.console.live.running import running, wait_until

pytestmark = pytest.mark.timeout(180)


def test_a_reset_begins_the_tour_anew_while_the_last_run_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = tmp_path / "run", tmp_path / "run_2"
    options = DemoOptions(
        world_name="original", camera=False, renderer="none", out_dir=first, goal=(-0.4, 0.1, 0.0)
    )
    closing = Rewriting.run

    def slowly(rewriting: Rewriting, timeout_s: float) -> str:
        # As for a long run.
        wait_until(lambda: may_end, 60.0)
        return closing(rewriting, timeout_s)

    may_end: list[bool] = []
    monkeypatch.setattr(Rewriting, "run", slowly)
    with ExitStack() as cleanup:
        run = cleanup.enter_context(running(options))
        cleanup.callback(may_end.append, True)
        page = cleanup.enter_context(run.page())
        page.done(do="simulation", speed=0.0)
        (bringup,) = (node for node in run.executive.nodes if node.name == "bringup")
        page.wait_for(lambda: bringup.exit_code == 0 and len(_results(page.events)) == 1)
        page.done(do="simulation", reset="all")
        page.wait_for(lambda: len(_results(page.events)) == 2)
        assert is_recording(first)
        assert is_recording(second)
    for folder in (first, second):
        assert not is_recording(folder)
        assert (folder / REPORT).is_file()


def _results(events: list[tuple[str, object]]) -> list[object]:
    return [one for kind, one in events if kind == "navigation_result"]
