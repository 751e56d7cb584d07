"""What a file of markers beside a map may say, and what it may not."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import MarkerDictionary
from mazebot.common.messages.slam_documents import GraphLandmark
from mazebot.common.problems import WorldError
from mazebot.common.world.map_files import MapFile
from mazebot.common.world.marker_file import MarkerFile, read_markers, write_markers

CHART = MapFile(np.zeros((40, 60), np.int8), 0.05, SE2(-1.0, 2.0, 0.0))
GOOD = {
    "id": "3",
    "dictionary": "DICT_4X4_100",
    "position_m": "[0.0, 3.0, 0.25]",
    "orientation_xyzw": "[0.5, 0.5, 0.5, 0.5]",
}


def read(folder: Path, **fields: str) -> MarkerFile:
    """A file of one marker, with these fields in place of good ones."""
    entry = ", ".join(f"{key}: {value}" for key, value in (GOOD | fields).items())
    path = folder / "markers.yaml"
    path.write_text(f"markers:\n- {{{entry}}}\n")
    own = MarkerDictionary(name="mine.yml", modules=2, codes=("0110", "1000"))
    return read_markers(path, (), dictionaries=(own,), chart=CHART)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("orientation_xyzw", "[0, 0, 0, 0]", "must be a unit quaternion x, y, z, w"),
        ("orientation_xyzw", "[1, 1, 1, 1]", "must be a unit quaternion x, y, z, w"),
        ("dictionary", "DICT_9X9_100", "must be one of DICT_4X4_100"),
        ("dictionary", "mine.yml", "must be less than 2 in mine.yml"),
        ("id", "100", "must be less than 100 in DICT_4X4_100"),
        ("id", "true", "must be a valid integer"),
        ("id", "'3'", "must be a valid integer"),
        ("instance", "'0'", "must be a valid integer"),
        ("position_m", "[0.0, 3000.0, 250.0]", "must be metres in the map's frame"),
        ("position_m", "['0', 3.0, 0.25]", "must be a valid number"),
        ("size_m", "0.1", "unknown field: must be one of id, dictionary"),
    ],
)
def test_what_would_not_be_used_as_meant_is_refused(
    field: str, value: str, said: str, tmp_path: Path
) -> None:
    with pytest.raises(WorldError) as caught:
        read(tmp_path, **{field: value})
    line = str(caught.value)
    assert said in line
    assert "\n" not in line
    wrong = "id" if "mine.yml" in value else field
    assert line.startswith(f"{tmp_path / 'markers.yaml'}:2: markers[0].{wrong}")


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    path = tmp_path / "markers.yaml"
    path.write_text("markers:\n- {id: 3}\n")
    with pytest.raises(WorldError, match=r"markers\[0\]\.dictionary: is missing$"):
        read_markers(path, ())


def test_a_rounded_quaternion_is_made_a_rotation(tmp_path: Path) -> None:
    found = read(tmp_path, orientation_xyzw="[0.0, 0.0, 0.71, 0.71]")
    assert math.hypot(*found.markers[0].orientation_xyzw) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("xyzw", "doubt"),
    [
        ("[0.5, 0.5, 0.5, 0.5]", ""),
        # It faces the y axis.
        ("[0.0, 0.70711, 0.70711, 0.0]", ""),
        # The same in the order w, x, y, z.
        ("[0.0, 0.0, 0.70711, 0.70711]", "lies flat"),
        ("[0, 0, 0, 1]", "lies flat"),
        ("[-0.5, -0.5, 0.5, 0.5]", "hangs turned or upside down"),
    ],
)
def test_one_that_does_not_hang_upright_is_a_warning(xyzw: str, doubt: str, tmp_path: Path) -> None:
    found = read(tmp_path, orientation_xyzw=xyzw)
    assert len(found.markers) == 1
    assert [doubt in line for line in found.warnings] == [True] * bool(doubt)


def test_what_mapping_writes_is_read(tmp_path: Path) -> None:
    landmark = GraphLandmark(
        dictionary="mine.yml", marker_id=1, instance=0, position_m=(0.0, 3.0, 0.25),
        orientation_xyzw=(0.5, 0.5, 0.5, 0.5), std_m=0.01, sightings=4,
    )  # fmt: skip
    path = tmp_path / "markers.yaml"
    write_markers(path, [landmark, landmark.model_copy(update={"instance": 1})])
    own = MarkerDictionary(name="mine.yml", modules=2, codes=("0110", "1000"))
    found = read_markers(path, (), dictionaries=(own,), chart=CHART)
    assert [one.marker_id for one in found.markers] == [1]
    assert not found.warnings
