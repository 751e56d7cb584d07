from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mazebot.common.config import ConfigError
from mazebot.navigation.config import FilterInfoServerParams, MaskServerParams, NavigationConfig
from mazebot.navigation.costmap.filters import FilterInfo
from mazebot.navigation.mask_files import masks_of, read_mask

GOOD = {
    "image": "mask.pgm", "mode": "trinary", "resolution": "0.1", "origin": "[-1.0, -2.0, 0.0]",
    "negate": "0", "occupied_thresh": "0.65", "free_thresh": "0.25",
}  # fmt: skip


def write(folder: Path, picture: object = None, **fields: str | None) -> str:
    grey = np.array([[0, 254, 254], [254, 254, 205]], np.uint8) if picture is None else picture
    Image.fromarray(np.asarray(grey)).save(folder / "mask.pgm")
    lines = [f"{name}: {value}" for name, value in (GOOD | fields).items() if value is not None]
    (folder / "mask.yaml").write_text("\n".join(lines))
    return str(folder / "mask.yaml")


def test_a_mask_is_read_with_its_frame(tmp_path: Path) -> None:
    named = read_mask("keepout_mask", write(tmp_path), FilterInfo())
    frame = named.mask.frame
    assert named.name == "mask.yaml"
    assert (frame.origin_x_m, frame.origin_y_m, frame.rows, frame.columns) == (-1.0, -2.0, 2, 3)
    # The picture's top left corner is at the greatest y.
    assert named.mask.cells.tolist() == [[0, 0, 0], [100, 0, 0]]


def test_speed_masks_have_the_value_of_each_pixel(tmp_path: Path) -> None:
    file = write(tmp_path, [[np.uint8(40), np.uint8(101)]], mode="raw")
    config = NavigationConfig(
        speed_filter_mask_server=MaskServerParams(yaml_filename=file),
        speed_costmap_filter_info_server=FilterInfoServerParams(type=2, base=0.0, multiplier=0.01),
    )
    (named,) = masks_of(config).speed
    assert named.mask.cells.tolist() == [[40, -1]]
    assert named.mask.info == FilterInfo(2, 0.0, 0.01)
    assert masks_of(config).keepout == ()


def test_what_is_transparent_in_mode_scale_is_unknown(tmp_path: Path) -> None:
    write(tmp_path)
    pixels = np.array([[[0, 255], [0, 0]]], np.uint8)
    Image.fromarray(pixels, "LA").save(tmp_path / "mask.png")
    file = write(tmp_path, mode="scale", image="mask.png")
    cells = read_mask("keepout_mask", file, FilterInfo()).mask.cells
    assert cells.tolist() == [[100, -1]]


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"resolution": None}, "mask.yaml.*: resolution: is missing"),
        ({"resolution": "-1"}, "resolution: -1: must be a number from 0.001 to 100"),
        ({"resolution": ".nan"}, "resolution: nan: must be a number"),
        ({"origin": "[0, 0]"}, r"origin: \(0, 0\): must be \[x, y, yaw\]"),
        ({"mode": "grey"}, "mode: 'grey': must be trinary, scale or raw"),
        ({"negate": "0.5"}, "negate: 0.5: must be 0 or 1"),
        ({"free_thresh": "0.9"}, "free_thresh: 0.9: must be < occupied_thresh, which is 0.65"),
        ({"image": "none.pgm"}, "image: 'none.pgm': no such file"),
        ({"image": "mask.yaml"}, "image: 'mask.yaml': must be a PGM, PNG or BMP image"),
        ({"image": "[1]"}, "image: .*: must be a file name"),
        ({"origin": "[0, 0"}, "mask.yaml:5: "),
    ],
)
def test_a_bad_mask_is_one_line_with_setting_file_and_field(
    fields: dict[str, str | None], says: str, tmp_path: Path
) -> None:
    file = write(tmp_path, **fields)
    with pytest.raises(ConfigError, match=says) as caught:
        masks_of(NavigationConfig(keepout_filter_mask_server=MaskServerParams(yaml_filename=file)))
    assert str(caught.value).startswith(f"keepout_filter_mask_server.yaml_filename: {file[:120]}")
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_mask_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "list.yaml").write_text("- 1")
    (tmp_path / "bytes.yaml").write_bytes(bytes(range(128, 256)))
    for name, says in (
        ("list.yaml", "must be a mapping of fields to values"),
        ("bytes.yaml", "bytes.yaml"),
        ("none.yaml", "No such file"),
        (".", "must be a file"),
    ):
        with pytest.raises(ConfigError, match=says) as caught:
            read_mask("speed_mask", str(tmp_path / name), FilterInfo(1, 100.0, -1.0))
        assert "\n" not in str(caught.value)
