from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from PIL import Image

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.world.map_files import (
    ImageFormat,
    MapFile,
    Mode,
    read_map,
    write_map,
)
from mazebot.worldgen.map.disagreement import disagreement, misfit

ORIGIN = SE2(-2.07, -1.64, 0.3)
META: dict[str, Any] = {
    "image": "m.pgm", "resolution": 0.05, "origin": [-1.0, 2.0, 0.0], "negate": 0,
    "occupied_thresh": 0.65, "free_thresh": 0.25,
}  # fmt: skip


def trinary(rows: int = 20, columns: int = 31) -> NDArray[np.int8]:
    rng = np.random.default_rng(3)
    return rng.choice(np.array([-1, 0, 100], np.int8), (rows, columns))


def every_value() -> NDArray[np.int8]:
    return np.arange(-1, 101, dtype=np.int8).reshape(6, 17)


def save(folder: Path, picture: Image.Image | bytes, **changed: Any) -> Path:
    """A map by what is to be in its files; a value of None takes the field away."""
    meta = {key: value for key, value in {**META, **changed}.items() if value is not None}
    image = folder / str(META["image"] if changed.get("image") is None else changed["image"])
    if isinstance(picture, bytes):
        image.write_bytes(picture)
    else:
        picture.save(image)
    (folder / "m.yaml").write_text(yaml.safe_dump(meta), encoding="utf-8")
    return folder / "m.yaml"


def greys(*values: int) -> Image.Image:
    return Image.fromarray(np.array([values], np.uint8))


@pytest.mark.parametrize("image_format", ["pgm", "png", "bmp"])
@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_what_is_written_is_read_again(
    tmp_path: Path, mode: Mode, image_format: ImageFormat
) -> None:
    cells = trinary() if mode == "trinary" else every_value()
    if mode == "scale" and image_format != "png":
        with pytest.raises(ConfigError, match="must be png, for the unknown cells of mode scale"):
            write_map(tmp_path, "m", cells, 0.05, ORIGIN, mode, image_format)
        assert list(tmp_path.iterdir()) == []
        cells = cells.clip(0, None)
    path = write_map(tmp_path / "new", "m", cells, 0.05, ORIGIN, mode, image_format)
    assert path == tmp_path / "new" / "m.yaml"
    assert sorted(file.name for file in path.parent.iterdir()) == [f"m.{image_format}", "m.yaml"]
    read = read_map(path)
    assert np.array_equal(read.cells, cells)
    assert (read.resolution_m, read.origin) == (0.05, ORIGIN)


def test_written_files_are_those_of_map_saver(tmp_path: Path) -> None:
    path = write_map(tmp_path, "house", np.array([[0, 100], [-1, 50]], np.int8), 0.05, ORIGIN)
    # Row 0 is at the bottom of a map, and at the top of a picture.
    assert (tmp_path / "house.pgm").read_bytes() == b"P5\n2 2\n255\n" + bytes([205, 205, 254, 0])
    assert yaml.safe_load(path.read_text()) == {
        "image": "house.pgm", "mode": "trinary", "resolution": 0.05, "origin": [-2.07, -1.64, 0.3],
        "negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196,
    }  # fmt: skip


def test_thresholds_are_those_of_map_server(tmp_path: Path) -> None:
    # 1 - 205 / 255 is 0.196: with map_saver's own threshold its unknown is read as free.
    wide = read_map(save(tmp_path, greys(0, 89, 90, 191, 192, 205, 254)))
    assert wide.cells.tolist() == [[100, 100, -1, -1, 0, 0, 0]]
    narrow = read_map(save(tmp_path, greys(0, 89, 90, 204, 205, 206), free_thresh=0.196))
    assert narrow.cells.tolist() == [[100, 100, -1, -1, -1, 0]]
    negated = read_map(save(tmp_path, greys(0, 128, 255), negate=1))
    assert negated.cells.tolist() == [[0, -1, 100]]


def test_in_scale_mode_what_is_between_is_spread_and_what_is_seen_through_unknown(
    tmp_path: Path,
) -> None:
    cells = read_map(save(tmp_path, greys(0, 89, 90, 147, 204, 255), free_thresh=0.196,
                          mode="Scale")).cells  # fmt: skip
    assert cells.tolist() == [[100, 100, 99, 50, 1, 0]]
    seen_through = np.zeros((1, 3, 4), np.uint8)
    seen_through[0, :, 3] = (255, 254, 0)
    picture = Image.fromarray(seen_through)
    path = save(tmp_path, picture, image="m.png", mode="scale")
    assert read_map(path).cells.tolist() == [[100, -1, -1]]
    path = save(tmp_path, picture, image="m.png")
    assert read_map(path).cells.tolist() == [[100, -1, -1]]


def test_a_picture_with_an_opaque_alpha_channel_is_that_without_it(tmp_path: Path) -> None:
    grey = greys(0, 90, 205, 254).convert("RGBA")
    path = save(tmp_path, grey, image="m.png", free_thresh=0.196)
    assert read_map(path).cells.tolist() == [[100, -1, -1, 0]]


@pytest.mark.parametrize("name", ["m.pgm", "m.png"])
def test_sixteen_bits_a_channel_are_read_as_eight(tmp_path: Path, name: str) -> None:
    deep = np.array([[0, 89, 90, 205, 206, 254, 255]], np.uint16) * 257
    path = save(tmp_path, Image.fromarray(deep), image=name, free_thresh=0.196)
    assert read_map(path).cells.tolist() == [[100, 100, -1, -1, 0, 0, 0]]
    save(tmp_path, Image.fromarray(deep), image=name, mode="raw")
    assert read_map(path).cells.tolist() == [[0, 89, 90, -1, -1, -1, -1]]
    plain = b"P2\n3 1\n65535\n0 23130 65535\n"
    assert read_map(save(tmp_path, plain)).cells.tolist() == [[100, -1, 0]]


def test_numbers_in_quotes_are_numbers(tmp_path: Path) -> None:
    path = save(
        tmp_path, greys(0, 255), resolution="0.05", origin=["-1.5", "2", "1e-1"], negate="true",
        occupied_thresh="0.65", free_thresh=".196",
    )  # fmt: skip
    read = read_map(path)
    assert (read.resolution_m, read.origin) == (0.05, SE2(-1.5, 2.0, 0.1))
    assert read.cells.tolist() == [[0, 100]]


def test_unknown_that_becomes_free_is_counted(tmp_path: Path) -> None:
    path = save(tmp_path, greys(0, 205, 205, 254))
    assert "free_thresh: 0.25: 2 cells of grey 205" in read_map(path).warning
    assert read_map(save(tmp_path, greys(0, 205, 254), free_thresh=0.196)).warning == ""
    assert read_map(save(tmp_path, greys(0, 204, 254))).warning == ""


def test_raw_values_are_cells(tmp_path: Path) -> None:
    path = save(tmp_path, greys(0, 1, 100, 101, 255), mode="raw", negate=1)
    assert read_map(path).cells.tolist() == [[0, 1, 100, -1, -1]]


def test_colours_are_averaged_whatever_the_picture_is_stored_as(tmp_path: Path) -> None:
    colours = np.array([[(255, 0, 0), (255, 255, 0), (255, 255, 255)]], np.uint8)
    for name in ("m.png", "m.bmp"):
        path = save(tmp_path, Image.fromarray(colours), image=name)
        assert read_map(path).cells.tolist() == [[100, -1, 0]]
    palette = Image.fromarray(colours).convert("P", palette=Image.Palette.ADAPTIVE)
    assert read_map(save(tmp_path, palette, image="m.png")).cells.tolist() == [[100, -1, 0]]
    bits = Image.fromarray(np.array([[0, 255]], np.uint8)).convert("1")
    assert read_map(save(tmp_path, bits, image="m.png")).cells.tolist() == [[100, 0]]


def test_a_pgm_in_digits_is_read_too(tmp_path: Path) -> None:
    plain = b"P2\n# made by hand\n3 2 # wide, high\n15\n0 15 6\n15 0 6\n"
    assert read_map(save(tmp_path, plain)).cells.tolist() == [[0, 100, -1], [100, 0, -1]]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"image": None}, "image: is missing"),
        ({"image": 7}, "image: 7: must be a file name"),
        ({"resolution": -0.05}, "resolution: -0.05: must be a number from 0.001 to 100"),
        ({"resolution": math.nan}, "resolution: nan: must be a number"),
        ({"resolution": "5 cm"}, "resolution: '5 cm': must be a number"),
        ({"resolution": True}, "resolution: True: must be a number"),
        ({"resolution": 10**40}, "must be a number"),
        ({"origin": [0.0, 0.0]}, "must be [x, y, yaw], metres and radians"),
        ({"origin": [0.0, math.inf, 0.0]}, "must be [x, y, yaw], metres and radians"),
        ({"origin": [1e9, 0.0, 0.0]}, "must be [x, y, yaw], metres and radians"),
        ({"origin": "here"}, "origin: 'here': must be [x, y, yaw]"),
        ({"negate": 2}, "negate: 2: must be 0 or 1"),
        ({"negate": None}, "negate: is missing"),
        ({"occupied_thresh": 65}, "occupied_thresh: 65: must be a number from 0 to 1"),
        ({"free_thresh": 0.7}, "free_thresh: 0.7: must be < occupied_thresh, which is 0.65"),
        ({"free_thresh": 0.65}, "must be < occupied_thresh"),
        ({"mode": "best"}, "mode: 'best': must be trinary, scale or raw"),
        ({"mode": ["raw"]}, "must be trinary, scale or raw"),
    ],
)
def test_a_bad_field_is_told_in_one_line(
    tmp_path: Path, changed: dict[str, Any], message: str
) -> None:
    path = save(tmp_path, greys(0, 255))
    meta = {key: value for key, value in {**META, **changed}.items() if value is not None}
    path.write_text(yaml.safe_dump(meta), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        read_map(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "must be a PGM, PNG or BMP image"),
        (b"P5\n4 4\n255\nabc", "is truncated or corrupt"),
        (
            b"P5\n40000 40000\n255\nabc",
            "must have at most 16000000 pixels",
        ),
        (b"P5\n5000 4000\n255\nabc", "has 5000 x 4000 pixels: must have at least 1 and at most"),
        (b"P2\n40000 40000\n255\n1 2 3", "has 40000 x 40000 pixels"),
        (b"P2\n2 2\n255\n1 2 3", "is truncated or corrupt"),
        (b"P2\n2 2\n255\n1 2 3 x", "is truncated or corrupt"),
        (b"P2\n2 2\n255\n1 2 3 256", "is truncated or corrupt"),
        (b"P2\n2 2\n65536\n1 2 3 4", "must have 8 or 16 bits a channel"),
        (b"P2\n0 2\n255\n1", "has 0 x 2 pixels"),
        (b"P2\n99999999999999999999 2\n255\n1", "is truncated or corrupt"),
        (b"P5\n1 2\n65535\nabc", "is truncated or corrupt"),
        (b"GIF89a", "must be a PGM, PNG or BMP image"),
    ],
)
def test_a_bad_picture_is_told_in_one_line(tmp_path: Path, data: bytes, message: str) -> None:
    with pytest.raises(ConfigError, match=r"m\.pgm") as caught:
        read_map(save(tmp_path, data))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_picture_cut_anywhere_is_a_mistake(tmp_path: Path) -> None:
    write_map(tmp_path, "m", trinary(), 0.05, ORIGIN, "trinary", "png")
    whole = (tmp_path / "m.png").read_bytes()
    for size in range(0, len(whole) - 16, 7):
        (tmp_path / "m.png").write_bytes(whole[:size])
        with pytest.raises(ConfigError, match=r"must be a PGM|truncated"):
            read_map(tmp_path / "m.yaml")


def test_a_picture_may_lie_anywhere(tmp_path: Path) -> None:
    inner = tmp_path / "maps"
    (tmp_path / "images").mkdir()
    inner.mkdir()
    greys(0, 255).save(tmp_path / "images" / "m.pgm")
    (inner / "link.pgm").symlink_to(tmp_path / "images" / "m.pgm")
    for name in ("../images/m.pgm", str(tmp_path / "images" / "m.pgm"), "link.pgm"):
        (inner / "m.yaml").write_text(yaml.safe_dump({**META, "image": name}))
        assert read_map(inner / "m.yaml").cells.tolist() == [[100, 0]]


@pytest.mark.parametrize(
    ("image", "hint"),
    [
        (f"/home/someone/{'ws/src/' * 12}robot/maps/room.pgm", "write image: room.pgm"),
        ("../maps/Room.PGM", "write image: room.pgm"),
        ("C:\\robot\\maps\\room.pgm", "write image: room.pgm"),
        ("elsewhere/room.png", "a room.pgm lies beside the YAML file: write image: room.pgm"),
        ("other.pgm", "other.pgm"),
    ],
)
def test_a_picture_that_is_not_there_is_told_with_the_one_beside(
    tmp_path: Path, image: str, hint: str
) -> None:
    greys(0, 255).save(tmp_path / "room.pgm")
    (tmp_path / "m.yaml").write_text(yaml.safe_dump({**META, "image": image}))
    with pytest.raises(ConfigError, match=r"m\.yaml:\d+: image: '.*': no such file") as caught:
        read_map(tmp_path / "m.yaml")
    assert str(caught.value).endswith(hint)
    assert "\n" not in str(caught.value)


def test_what_cannot_be_written_is_told_in_one_line(tmp_path: Path) -> None:
    cells = trinary()
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be written"):
        write_map(tmp_path / "file", "m", cells, 0.05, ORIGIN)
    for name, mode, image_format in (
        ("../m", "trinary", "pgm"), ("m", "best", "pgm"), ("m", "raw", "gif"),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match="must be"):
            write_map(tmp_path, name, cells, 0.05, ORIGIN, mode, image_format)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="must have at least one row"):
        write_map(tmp_path, "m", cells[:0], 0.05, ORIGIN)
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


def house() -> MapFile:
    """A room of 8 m by 6 m with a wall into it, unknown outside, at 5 cm."""
    cells = np.full((160, 200), -1, np.int8)
    cells[20:141, 20:181] = 0
    cells[20:141, [20, 21, 179, 180]] = cells[[20, 21, 139, 140], 20:181] = 100
    cells[20:90, 80:83] = 100
    return MapFile(cells, 0.05, SE2(-3.0, -2.0, 0.0))


def test_the_same_map_disagrees_in_nothing() -> None:
    same = disagreement(house(), house())
    assert (same.mean_m, same.max_m, same.share_within_5_cm) == (0.0, 0.0, 1.0)
    assert (same.offset_x_m, same.offset_y_m, same.share_contradicted) == (0.0, 0.0, 0.0)
    assert "shifted" not in str(same)


@pytest.mark.parametrize(
    "offset", [(0.678, 0.678), (-0.31, 1.2), (0.0, 0.05), (5.8, -0.4), (-31.0, 47.3)]
)
def test_a_shifted_map_is_told_as_shifted(offset: tuple[float, float]) -> None:
    own = house()
    shifted = MapFile(own.cells, 0.05, SE2(*offset, 0.0) @ own.origin)
    told = disagreement(shifted, own)
    assert told.offset_x_m == pytest.approx(-offset[0], abs=0.01)
    assert told.offset_y_m == pytest.approx(-offset[1], abs=0.01)
    assert told.mean_after_offset_m < 0.01
    assert told.mean_m > 0.01
    apart = max(map(abs, offset)) > 10.0
    assert told.share_contradicted == 0.0 if apart else told.share_contradicted > 0.01
    assert "\n" not in str(told)
    assert f"shifted by ({told.offset_x_m:+.3f}, {told.offset_y_m:+.3f}) m" in str(told)


@pytest.mark.parametrize("offset_m", [0.04, 0.12, 0.68, 5.8, 60.0])
def test_a_map_does_not_fit_from_two_cells_of_offset_on(offset_m: float) -> None:
    own = house()
    told = misfit(MapFile(own.cells, 0.05, SE2(offset_m, 0.0, 0.0) @ own.origin), own)
    assert bool(told) == (offset_m > 0.1)
    assert not told or f"shifted by ({-offset_m:+.3f}, +0.000) m" in told


def test_a_turned_map_of_another_resolution_is_compared_in_the_world() -> None:
    own = house()
    points = np.argwhere(np.ones((330, 410), np.bool_))
    turned = SE2(-3.0, -2.0, 0.2)
    x, y = (points[:, 1] + 0.5) * 0.025, (points[:, 0] + 0.5) * 0.025
    at_x = -3.0 + math.cos(0.2) * x - math.sin(0.2) * y
    at_y = -2.0 + math.sin(0.2) * x + math.cos(0.2) * y
    column = np.floor((at_x + 3.0) / 0.05).astype(int)
    row = np.floor((at_y + 2.0) / 0.05).astype(int)
    inside = (row >= 0) & (row < 160) & (column >= 0) & (column < 200)
    cells = np.full(330 * 410, -1, np.int8)
    cells[inside] = own.cells[row[inside], column[inside]]
    told = disagreement(MapFile(cells.reshape(330, 410), 0.025, turned), own)
    assert told.share_contradicted == 0.0
    straight = SE2(turned.x_m, turned.y_m, 0.0)
    told = disagreement(MapFile(cells.reshape(330, 410), 0.025, straight), own)
    assert told.share_contradicted > 0.01


def test_what_is_inside_something_solid_and_what_the_map_does_not_know_count_for_nothing() -> None:
    own = house()
    own.cells[100:139, 100:150] = 100
    seen = own.cells.copy()
    seen[102:139, 102:148] = -1
    told = disagreement(MapFile(seen, 0.05, own.origin), own)
    assert (told.mean_m, told.max_m) == (0.0, 0.0)
    # Only the part up to the wall in the middle has been seen.
    seen[:, 84:] = -1
    told = disagreement(MapFile(seen, 0.05, own.origin), own)
    assert told.max_m < 0.1
    # A block of the map that the world does not have is one.
    seen = house().cells
    seen[100:138, 30:60] = 100
    assert disagreement(MapFile(seen, 0.05, own.origin), house()).max_m > 1.0


def test_without_a_wall_there_is_nothing_to_compare() -> None:
    own = house()
    empty = MapFile(np.zeros((5, 5), np.int8), 0.05, own.origin)
    with pytest.raises(ValueError, match="the map has no occupied cell beside"):
        disagreement(empty, own)
    with pytest.raises(ValueError, match="the world has no occupied cell beside"):
        disagreement(own, empty)
