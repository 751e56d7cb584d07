"""Profiles of known sensors: a profile's name gives the values of all fields that are not set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from pydantic.fields import FieldInfo

NEAR_M = 0.02
FAR_M = 300.0
"""Clipping distances of every camera, those of ROBOTIS' simulated waffle."""


@dataclass(frozen=True)
class ScanProfile:
    """A lidar. Its fields are the configuration's, by the same names."""

    scan_rate_hz: float
    scan_samples: int
    scan_range_min_m: float
    scan_range_max_m: float
    scan_noise_m: float
    scan_noise_share: float
    scan_resolution_m: float


SCAN_PROFILES: Mapping[str, ScanProfile] = MappingProxyType(
    {
        # ROBOTIS' simulated waffle: 10 Hz, 0.12 to 3.5 m, sigma 1 cm. The sensor's driver gives
        # whole millimetres. The 15 mm that the simulated model names are not applied by Gazebo
        # (gz-sensors issue 84), nor here.
        "lds01": ScanProfile(
            scan_rate_hz=10.0,
            scan_samples=360,
            scan_range_min_m=0.12,
            scan_range_max_m=3.5,
            scan_noise_m=0.01,
            scan_noise_share=0.0,
            scan_resolution_m=0.001,
        ),
        # ROBOTIS e-Manual, appendix LDS-02: 5 Hz, 1 degree, 0.16 to 8 m, accurate to 10 mm below
        # 0.3 m and to 3 % up to 6 m (5 % beyond). These bounds are taken as three sigma.
        "lds02": ScanProfile(
            scan_rate_hz=5.0,
            scan_samples=360,
            scan_range_min_m=0.16,
            scan_range_max_m=8.0,
            scan_noise_m=0.01 / 3.0,
            scan_noise_share=0.01,
            scan_resolution_m=0.001,
        ),
        # nav2_minimal_turtlebot_simulation's gz_waffle. Its least range is 1e-5 m, with which
        # Gazebo's rays hit the robot itself; no ray hits the robot here.
        "gazebo": ScanProfile(
            scan_rate_hz=5.0,
            scan_samples=360,
            scan_range_min_m=1e-5,
            scan_range_max_m=20.0,
            scan_noise_m=0.01,
            scan_noise_share=0.0,
            scan_resolution_m=0.0,
        ),
    }
)


@dataclass(frozen=True)
class CameraProfile:
    """A colour and depth camera. Its fields are the configuration's, by the same names."""

    camera_rate_hz: float
    camera_width_px: int
    camera_height_px: int
    camera_horizontal_fov_rad: float
    camera_depth_min_m: float
    camera_depth_max_m: float
    camera_noise: float


_D435I = CameraProfile(
    camera_rate_hz=10.0,
    camera_width_px=640,
    camera_height_px=480,
    camera_horizontal_fov_rad=1.047,
    camera_depth_min_m=0.175,
    camera_depth_max_m=10.0,
    camera_noise=0.0,
)

CAMERA_PROFILES: Mapping[str, CameraProfile] = MappingProxyType(
    {
        # The field of view is that of nav2_minimal_turtlebot_simulation's gz_waffle, whose camera
        # is named D435i. The least depth is the one in Intel's D400 data sheet at 640 x 480; the
        # greatest is where the real camera's depth becomes useless.
        "d435i": _D435I,
        # ROBOTIS' simulated waffle.
        "waffle": CameraProfile(
            camera_rate_hz=30.0,
            camera_width_px=1920,
            camera_height_px=1080,
            camera_horizontal_fov_rad=1.02974,
            camera_depth_min_m=0.02,
            camera_depth_max_m=300.0,
            camera_noise=0.007,
        ),
        # A quarter of the pixels: gz_waffle's size.
        "small": replace(_D435I, camera_width_px=320, camera_height_px=240),
    }
)


def filled_in(
    values: Any,
    fields: Mapping[str, FieldInfo],
    profiles: Mapping[str, Mapping[str, DataclassInstance]],
) -> Any:
    """A configuration's raw values; those that are not set are taken from the chosen profiles.

    `profiles` maps the field that chooses a profile to the profiles by name. An unknown name
    fills in nothing: the validation of its field reports it.
    """
    if not isinstance(values, Mapping):
        return values
    filled: dict[str, Any] = {}
    for field, by_name in profiles.items():
        chosen = values.get(field, fields[field].default)
        if isinstance(chosen, str) and chosen in by_name:
            filled.update(asdict(by_name[chosen]))
    return {**filled, **values}
