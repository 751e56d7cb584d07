"""Tags and notes."""

from __future__ import annotations

from pathlib import Path

import pytest

from mazebot.common.config import ConfigError
from mazebot.common.recordings.labels import Labels, read_labels, relabelled, write_labels


def test_labels_are_kept_in_the_runs_folder(tmp_path: Path) -> None:
    assert read_labels(tmp_path) == Labels()
    labels = relabelled(Labels(), ("slow", "keep", "slow"), note="ü\n<b>")
    assert labels.tags == ("keep", "slow")
    write_labels(tmp_path, labels)
    assert read_labels(tmp_path) == labels
    assert [path.name for path in tmp_path.iterdir()] == ["labels.json"]
    changed = relabelled(labels, remove=("keep", "unknown"))
    assert (changed.tags, changed.note) == (("slow",), "ü\n<b>")


def test_without_labels_there_is_no_file(tmp_path: Path) -> None:
    write_labels(tmp_path, Labels(tags=("keep",)))
    write_labels(tmp_path, Labels())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("tag", ["", "a b", "-x", "../x", "<b>", "x" * 41, "a\n", "ü"])
def test_a_tag_that_is_none_is_refused_in_one_line(tag: str) -> None:
    with pytest.raises(ConfigError, match="must be letters") as refused:
        relabelled(Labels(), (tag,))
    assert "\n" not in str(refused.value)


def test_there_is_an_end_to_tags_and_notes() -> None:
    with pytest.raises(ConfigError, match="tags"):
        relabelled(Labels(), tuple(f"t{number}" for number in range(51)))
    with pytest.raises(ConfigError, match="note"):
        relabelled(Labels(), note="x" * 10_001)


@pytest.mark.parametrize("text", ["", "{}x", '{"tags": 3}', '{"tag": []}', '{"tags": ["a b"]}'])
def test_a_file_of_something_else_is_told_of(tmp_path: Path, text: str) -> None:
    (tmp_path / "labels.json").write_text(text)
    with pytest.raises(ConfigError, match=r"labels\.json: "):
        read_labels(tmp_path)


def test_what_cannot_be_written_is_told_of(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        write_labels(tmp_path / "nowhere", Labels(tags=("keep",)))
