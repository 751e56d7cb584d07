"""Parameters of localisation, under AMCL's names where it has one."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from mazebot.common.config import Params


class InitialPose(Params):
    """AMCL's `initial_pose`: the pose to start from where `set_initial_pose` is true."""

    x: float = Field(0.0, description="m, in the map")
    y: float = Field(0.0, description="m, in the map")
    z: float = Field(0.0, description="m; not used: the floor is flat")
    yaw: float = Field(0.0, description="rad, in the map")


class LocalizationParams(Params):
    """Parameters of the particle filter, of its judgement and of the search from nothing.

    The defaults fit a lidar with 0.01 m of noise, wheels that slip by a few percent and a map with
    cells of 0.05 m; AMCL's own (sigma_hit 0.2, z_rand 0.5, alpha 0.2) fit a far worse robot.
    """

    min_particles: int = Field(500, ge=10, description="particles while the pose is certain")
    max_particles: int = Field(2000, ge=10, description="particles at the start, and at most")
    pf_err: float = Field(0.05, gt=0, description="KLD sampling: error of the distribution")
    pf_z: float = Field(2.33, gt=0, description="KLD sampling: normal quantile; 2.33 is 99 %")
    alpha1: float = Field(0.02, ge=0, description="variance of a turn for each rad^2 of turn")
    alpha2: float = Field(0.02, ge=0, description="variance of a turn for each m^2 of move")
    alpha3: float = Field(0.02, ge=0, description="variance of a move for each m^2 of move")
    alpha4: float = Field(0.002, ge=0, description="variance of a move for each rad^2 of turn")
    alpha5: float = Field(
        0.02, ge=0, description="variance of a move sideways; a differential drive has none"
    )
    odometry_scale_std: float = Field(
        0.04,
        ge=0,
        description="standard deviation of odometry's scale in moves and in turns, as a share: "
        "slip and a wrong wheel radius, which do not average out; each particle has its own",
    )
    max_beams: int = Field(90, ge=1, description="beams of a scan that weight the particles")
    z_hit: float = Field(0.9, gt=0, le=1, description="share of returns that come from the map")
    z_rand: float = Field(0.1, gt=0, le=1, description="share of returns from anything else")
    sigma_hit: float = Field(
        0.04,
        gt=0,
        description="m; scatter of returns about the map's walls: lidar noise (0.01) and the "
        "position of a wall's face in its cell (0.05 / sqrt 12), doubled for other errors",
    )
    laser_max_range: float = Field(
        100.0, gt=0, description="m; farther returns are not used; the scan's own limit counts, too"
    )
    laser_min_range: float = Field(
        -1.0, description="m; nearer returns are not used; negative: the scan's own limit"
    )
    laser_likelihood_max_dist: float = Field(
        2.0, gt=0, description="m; distances to the nearest obstacle are limited to this"
    )
    wall_inset_cells: float = Field(
        0.5,
        ge=0,
        le=1,
        description="how far inside its occupied cells a wall's face lies: 0.5 where a cell is "
        "occupied when a wall or a return lies anywhere in it, 0 where its centre decides",
    )
    beam_weight: float = Field(
        0.15,
        gt=0,
        le=1,
        description="weight of one beam: neighbours share the map raster's error on their wall",
    )
    min_returns: int = Field(10, ge=1, description="a scan with fewer returns is not used")
    update_min_d: float = Field(0.05, ge=0, description="m; least move between two updates")
    update_min_a: float = Field(0.05, ge=0, description="rad; least turn between two updates")
    still_update_period_s: float = Field(
        1.0, gt=0, description="time between two updates while the robot is at rest"
    )
    resample_interval: int = Field(
        1, ge=1, description="updates between two resamplings, which are only done when needed"
    )
    resample_share: float = Field(
        0.5, gt=0, le=1, description="resample below this share of effective particles"
    )
    tempering_share: float = Field(
        0.1, ge=0, le=1, description="one measurement leaves this share of effective particles"
    )
    roughening_m: float = Field(
        0.004, ge=0, description="least spread of the particles after resampling"
    )
    roughening_rad: float = Field(
        0.004, ge=0, description="least spread of the particles after resampling"
    )
    roughening_ratio: float = Field(
        0.3,
        ge=0,
        lt=1,
        description="spread that resampling gives to copies, as a share of the particles' own; "
        "they shrink to their mean by as much, so that the whole spread stays what it was",
    )
    scan_match_tolerance_m: float = Field(
        0.1, gt=0, description="a beam that ends this near to a wall fits the map"
    )
    recovery_alpha_slow: float = Field(
        0.001, gt=0, le=1, description="gain of the long mean of the scan match"
    )
    recovery_alpha_fast: float = Field(
        0.2, gt=0, le=1, description="gain of the short mean of the scan match"
    )
    converged_std_m: float = Field(
        0.15, gt=0, description="the pose is certain below this spread of the particles"
    )
    converged_std_rad: float = Field(
        0.1, gt=0, description="the pose is certain below this spread of the particles"
    )
    settled_ratio: float = Field(
        0.2, gt=0, le=1, description="above this share of the converged spread every scan is used"
    )
    marker_std_m: float = Field(
        0.02, gt=0, description="standard deviation of a marker's position at any range"
    )
    marker_range_ratio_per_m: float = Field(
        0.02, ge=0, description="standard deviation of a marker's range, as a share of it per metre"
    )
    marker_bearing_std_rad: float = Field(
        0.015, ge=0, description="standard deviation of a marker's bearing"
    )
    marker_yaw_std_rad: float = Field(0.1, gt=0, description="standard deviation of a marker's yaw")
    marker_outlier: float = Field(
        1e-3, gt=0, lt=1, description="probability that a marker's detection is an outlier"
    )
    dynamic_share: float = Field(
        0.35,
        ge=0,
        le=1,
        description="share of the beams that things which are not in the map may shorten without "
        "loss of quality",
    )
    suspect_quality: float = Field(
        0.75,
        gt=0,
        le=1,
        description="below this share of its long mean, the quality of the pose is suspect",
    )
    lost_after_s: float = Field(
        1.0,
        gt=0,
        description="time for which the quality is suspect before searching for another pose",
    )
    lost_margin: float = Field(
        0.15, gt=0, le=1, description="by how much another pose's quality must be better"
    )
    max_hypotheses: int = Field(
        256, ge=8, description="candidate poses while searching for the pose"
    )
    search_min_travel_m: float = Field(
        1.0,
        ge=0,
        description="m; least distance driven, a turn of 1 rad counting 0.25 m, before a pose "
        "found by lidar alone is trusted",
    )
    search_min_travel_open_m: float = Field(
        4.0,
        ge=0,
        description="m; the same where the robot may as well be where the map shows nothing: a "
        "place there can look like one that it shows",
    )
    search_certainty: float = Field(
        0.999, gt=0.5, lt=1, description="least probability of a pose that is trusted"
    )
    set_initial_pose: bool = Field(
        False, description="true: start at initial_pose, not at the world's start"
    )
    initial_pose: InitialPose = Field(
        default_factory=InitialPose, description="where the robot starts"
    )

    @model_validator(mode="after")
    def _can_use_scans(self) -> Self:
        self._check_order("min_returns", "max_beams")
        return self
