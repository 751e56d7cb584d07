"""Which observation sources of a costmap's layer are the lidar, and what of theirs counts here.

In Nav2 each source marks and clears by its own parameters; here all that are the lidar share one
section.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mazebot.common.nav2_params.parameter import Value

_KIND = "LaserScan"
_TOPIC = "scan"
_FILLED_IN = "$("
"""By a launch file."""
_NAV2_DOES = {"marking": True, "clearing": False}
"""Nav2's defaults."""
_DOES = {"marking": "marks", "clearing": "clears"}
_PART_OF = {
    "obstacle_max_range": "marking",
    "obstacle_min_range": "marking",
    "raytrace_max_range": "clearing",
    "raytrace_min_range": "clearing",
    "inf_is_valid": "clearing",
}


def lidars(listed: Sequence[str], prefix: str, values: Mapping[str, Value]) -> list[str]:
    """The listed sources that are the robot's lidar: of its data type, on its topic."""

    def stated(source: str, name: str, default: str) -> str:
        # Without one, or where a launch file fills it in, it is Nav2's default.
        given = str(values.get(f"{prefix}{source}.{name}") or default)
        return default if _FILLED_IN in given else given

    return [
        one
        for one in listed
        if stated(one, "data_type", _KIND) == _KIND
        and stated(one, "topic", one).lstrip("/") == _TOPIC
    ]


def why_not_taken(
    listed: Sequence[str], source: str, name: str, prefix: str, values: Mapping[str, Value]
) -> str:
    """Why a parameter of a listed source is not taken; empty: it is.

    The lidar marks or clears where one of its sources does, at the ranges of the first that does.
    """
    ours = lidars(listed, prefix, values)
    if source not in ours:
        return f"{source} is another sensor than the lidar, which is {_KIND} on {_TOPIC}"
    part = _PART_OF.get(name, name)
    if part not in _DOES:
        return ""
    doing = [
        one for one in ours if values.get(f"{prefix}{one}.{part}", _NAV2_DOES[part]) is not False
    ]
    if part == name and (source in doing or not doing):
        return ""
    first = (doing or ours)[0]
    if part == name:
        return f"{first}, the lidar as well, {_DOES[part]}"
    if source == first:
        return ""
    return f"that of {first} counts, the first source of the lidar that {_DOES[part]}"
