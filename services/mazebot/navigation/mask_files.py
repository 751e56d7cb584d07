"""Masks of keepout zones and speed limits, which are maps as Nav2's map_server reads them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mazebot.common.config import ConfigError
from mazebot.common.world.costmap import MAX_MAP_CELLS, straightened
from mazebot.navigation.config import FilterInfoServerParams, NavigationConfig
from mazebot.navigation.costmap.costmap import frame_of
from mazebot.navigation.costmap.filters import KEEPOUT, FilterInfo, FilterMask
from mazebot.navigation.costmap.zones import NamedMask


@dataclass(frozen=True, slots=True)
class Masks:
    """Those that a configuration names."""

    keepout: tuple[NamedMask, ...] = ()
    speed: tuple[NamedMask, ...] = ()


def masks_of(config: NavigationConfig) -> Masks:
    """The masks of a configuration. Raises ConfigError, see `read_mask`."""
    keepout, speed = config.keepout_filter_mask_server, config.speed_filter_mask_server
    return read_masks(
        ("keepout_filter_mask_server.yaml_filename", keepout.yaml_filename),
        ("speed_filter_mask_server.yaml_filename", speed.yaml_filename),
        config.speed_costmap_filter_info_server,
    )


def read_masks(
    keepout: tuple[str, str], speed: tuple[str, str], speed_info: FilterInfoServerParams
) -> Masks:
    """The masks of two settings, each with its file; an empty one is none. Raises ConfigError, see
    `read_mask`.
    """
    info = FilterInfo(**speed_info.model_dump())
    return Masks(
        (read_mask(*keepout, FilterInfo(KEEPOUT)),) if keepout[1] else (),
        (read_mask(*speed, info),) if speed[1] else (),
    )


def read_mask(setting: str, file: str, info: FilterInfo) -> NamedMask:
    """Read a mask by its YAML file, relative to the working directory.

    Raises ConfigError with one line that begins with the setting and names file, field and value.
    """
    from mazebot.common.world.map_files import read_map  # noqa: PLC0415 - loads images

    path = Path(file)
    try:
        info.check()
    except ValueError as error:
        raise ConfigError(f"{setting}: {error}") from error
    try:
        found = read_map(path)
    except ConfigError as error:
        raise ConfigError(f"{setting}: {error}") from error
    if found.cells.size > MAX_MAP_CELLS:
        raise ConfigError(
            f"{setting}: {path}: image: {found.cells.size} cells: must be at most {MAX_MAP_CELLS}"
        )
    origin, cells = straightened(found.resolution_m, found.origin, found.cells)
    frame = frame_of(found.resolution_m, origin, cells)
    return NamedMask(path.name, FilterMask(frame, cells, info))
