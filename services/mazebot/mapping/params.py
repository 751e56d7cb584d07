"""Parameters of mapping, under slam_toolbox's names where they mean the same."""

from __future__ import annotations

from pydantic import Field

from mazebot.common.config import Params

_LEAST_LINE_CELL_M = 0.05


class SlamParams(Params):
    """Parameters of the scan matching, the keyframes, the loops and the grid.

    The defaults fit a lidar with 0.01 m of noise on a robot of house size; slam_toolbox's own fit
    longer ranges and fewer scans.
    """

    resolution: float = Field(0.05, ge=0.01, le=1.0, description="m; side of the map's cells")
    max_laser_range: float = Field(
        40.0, gt=0, description="m; beams are cut here; the scan's own limit counts, too"
    )
    min_laser_range: float = Field(
        -1.0, description="m; nearer returns are not used; negative: the scan's own limit"
    )
    minimum_time_interval: float = Field(
        0.0, ge=0, description="s; scans that follow faster are not used"
    )
    minimum_travel_distance: float = Field(
        0.25, gt=0, description="m; a scan this far from every keyframe around becomes one"
    )
    minimum_travel_heading: float = Field(
        0.26, gt=0, description="rad; the same for its heading, where the lidar does not see around"
    )
    use_scan_matching: bool = Field(
        True, description="false: the pose is odometry's, and loops alone correct it"
    )
    link_match_minimum_response_fine: float = Field(
        0.5,
        ge=0,
        le=1,
        description="below this share of returns that fit the map around, the pose is searched for "
        "in the correlation's window",
    )
    link_scan_maximum_distance: float = Field(
        3.0,
        gt=0,
        description="m; keyframes nearer than this are matched against, and where they stand far "
        "apart, those as far away as the lidar sees",
    )
    scan_buffer_size: int = Field(
        40, ge=1, description="keyframes at most that a scan is matched against, the nearest ones"
    )
    correlation_search_space_dimension: float = Field(
        0.5,
        gt=0,
        description="m; least side of the window that is searched where a scan fits badly; larger "
        "after a long step of odometry",
    )
    correlation_search_space_resolution: float = Field(
        0.05,
        ge=0.01,
        le=0.5,
        description="m; side of the cells that hold the lines of walls, which are exact: less than "
        "0.05 is taken as 0.05, since smaller cells would only reach less far",
    )
    correlation_search_space_smear_deviation: float = Field(
        0.08, gt=0, description="m; how far from a line a return still counts in the search"
    )
    coarse_search_angle_offset: float = Field(
        0.35, ge=0, description="rad; least half of the window in heading"
    )
    coarse_angle_resolution: float = Field(
        0.026, gt=0, description="rad; steps of heading in the window"
    )
    scan_match_std_m: float = Field(
        0.02,
        gt=0,
        description="least scatter of a return about its line, lidar's noise and the share of "
        "errors that neighbouring returns have in common; more where the scans show more",
    )
    odometry_translation_ratio: float = Field(
        0.1, ge=0, description="standard deviation of odometry's distance, as a share of it"
    )
    odometry_translation_std_m_per_sqrt_m: float = Field(
        0.03, ge=0, description="standard deviation of odometry's distance after one metre"
    )
    odometry_rotation_ratio: float = Field(
        0.1, ge=0, description="standard deviation of odometry's turns, as a share of them"
    )
    odometry_rotation_std_rad_per_sqrt_m: float = Field(
        0.25, ge=0, description="standard deviation of odometry's heading after one metre"
    )
    do_loop_closing: bool = Field(
        True, description="whether to search for loop closures by lidar and markers"
    )
    loop_search_maximum_distance: float = Field(
        4.0, gt=0, description="m; keyframes this near by estimate may close a loop"
    )
    loop_search_space_dimension: float = Field(
        8.0, gt=0, description="m; side of the window that is searched for a loop"
    )
    loop_search_space_resolution: float = Field(
        0.05, gt=0, description="m; side of the cells of that search"
    )
    loop_match_minimum_response_coarse: float = Field(
        0.5, ge=0, le=1, description="least score of a loop before it is refined"
    )
    loop_match_minimum_response_fine: float = Field(
        0.6, ge=0, le=1, description="least score of a loop"
    )
    loop_match_minimum_chain_size: int = Field(
        3, ge=1, description="keyframes of one pass that a loop needs on either side"
    )
    map_update_interval: float = Field(
        1.0, gt=0, description="s; least time between two maps that are published"
    )

    @property
    def line_cell_m(self) -> float:
        """Side of the cells that hold the lines of walls."""
        return max(self.correlation_search_space_resolution, _LEAST_LINE_CELL_M)
