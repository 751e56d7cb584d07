from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from mazebot.common.problems import WorldError
from mazebot.common.world.marker_entities import marker_entities
from mazebot.common.world.marker_picture import own_dictionaries
from mazebot.perception.config import PerceptionConfig
from mazebot.perception.find import MarkerFinder
from mazebot.perception.pose import Camera
from mazebot.worldgen.check import problems_of
from mazebot.worldgen.recipe.loader import load_world

CODES = ("1011000111001010010110110", "0110100101110010001011001", "1100110010010111010001101")
ROOM = {
    "wall_height_m": 1.0,
    "walls": [
        {"name": f"wall_{index}", "length_m": 4.0, "x_m": x, "y_m": y, "yaw_rad": yaw}
        for index, (x, y, yaw) in enumerate(
            [(0, 2, 0), (0, -2, 0), (2, 0, 1.5707963), (-2, 0, 1.5707963)]
        )
    ],
    "materials": {"plain": {"diffuse": [0.7, 0.7, 0.7, 1.0]}},
    "wall_materials": ["plain"],
    "start": {"x_m": 0.0, "y_m": 0.0},
}


def write(folder: Path, dictionary: str, number: int = 1, codes: tuple[str, ...] = CODES) -> None:
    """A world with one marker, and the file of its dictionary."""
    marker = {"id": number, "wall": "wall_1", "side": "left", "height_m": 0.25,
              "dictionary": dictionary}  # fmt: skip
    recipe = {"name": "own", **ROOM, "markers": [marker]}
    (folder / "own.yaml").write_text(yaml.safe_dump(recipe))
    (folder / "dictionaries").mkdir(exist_ok=True)
    lines = ["%YAML:1.0", "---", f"nmarkers: {len(codes)}", "markersize: 5"]
    lines += [f'marker_{index}: "{code}"' for index, code in enumerate(codes)]
    (folder / "dictionaries" / "mine.yml").write_text("\n".join(lines))


def test_a_marker_of_a_dictionary_of_ones_own_hangs_and_is_found(tmp_path: Path) -> None:
    write(tmp_path, "mine.yml")
    world = load_world("own", worlds_dir=tmp_path).world
    (codes,) = world.dictionaries
    assert (codes.name, codes.modules, codes.codes) == ("mine.yml", 5, CODES)
    entities, textures = marker_entities(world)
    (entity,) = entities.markers
    assert not entities.refused
    # Five modules, the border and the quiet zone.
    assert entity.panel_side_m == pytest.approx(0.3 * 9 / 7)
    picture = cv2.imdecode(
        np.frombuffer(textures[entity.texture_sha256], np.uint8), cv2.IMREAD_GRAYSCALE
    )
    assert picture is not None
    book = own_dictionaries(world.dictionaries)["mine.yml"]
    finder = MarkerFinder(PerceptionConfig())
    finder.register("mine.yml", 1, 0.3, book=book)
    small = cv2.resize(picture, (180, 180), interpolation=cv2.INTER_AREA)
    grey = np.full((480, 640), 180, np.uint8)
    grey[150:330, 230:410] = small
    camera = Camera(np.array([[554.4, 0, 320], [0, 554.4, 240], [0, 0, 1.0]]), np.zeros(5))
    (found,) = finder.find(np.asarray(grey, np.uint8), camera).found
    assert (found.dictionary, found.marker_id) == ("mine.yml", 1)
    # The same name with other codes is another dictionary.
    other = own_dictionaries([codes.model_copy(update={"codes": CODES[::-1]})])["mine.yml"]
    finder.clear()
    finder.register("mine.yml", 1, 0.3, book=other)
    finder.register("mine.yml", 0, 0.3, book=other)
    assert [one.marker_id for one in finder.find(np.asarray(grey, np.uint8), camera).found] == [1]


def test_the_worlds_hash_has_the_codes_in_it(tmp_path: Path) -> None:
    write(tmp_path, "mine.yml")
    before = load_world("own", worlds_dir=tmp_path).world.hash
    write(tmp_path, "mine.yml", codes=CODES[::-1])
    assert load_world("own", worlds_dir=tmp_path).world.hash != before
    write(tmp_path, "DICT_APRILTAG_36h11")
    without = load_world("own", worlds_dir=tmp_path).world
    assert without.dictionaries == ()
    assert [e.dictionary for e in marker_entities(without)[0].markers] == ["DICT_APRILTAG_36h11"]


@pytest.mark.parametrize(
    ("dictionary", "must"),
    [
        ("none.yml", "cannot be read: No such file"),
        ("../mine.yml", "must be the name of a file in"),
        ("short.yml", "short.yml: marker_0: '101': must be 25 digits"),
    ],
)
def test_a_dictionary_that_cannot_be_read_is_one_line(
    tmp_path: Path, dictionary: str, must: str
) -> None:
    write(tmp_path, dictionary)
    (tmp_path / "dictionaries" / "short.yml").write_text(
        'nmarkers: 1\nmarkersize: 5\nmarker_0: "101"\n'
    )
    with pytest.raises(WorldError) as caught:
        load_world("own", worlds_dir=tmp_path)
    text = str(caught.value)
    assert "own.yaml" in text
    assert f"markers[0].dictionary: '{dictionary}'" in text
    assert must in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("dictionary", "number", "must"),
    [
        ("mine.yml", 3, "markers[0].id: 3: must be less than 3 in mine.yml"),
        ("DICT_9X9", 0, "markers[0].dictionary: 'DICT_9X9': must be one of DICT_4X4_100"),
    ],
)
def test_a_marker_that_is_in_no_dictionary_is_told(
    tmp_path: Path, dictionary: str, number: int, must: str
) -> None:
    write(tmp_path, dictionary, number)
    problems = [str(problem) for problem in problems_of("own", worlds_dir=tmp_path)]
    assert any(must in problem for problem in problems), problems
