from __future__ import annotations

import pytest

from mazebot.common.messages.error_codes import ACTION_CODES, COMMON_CODES, ErrorCode, code_name


@pytest.mark.parametrize(
    ("action", "code", "name"),
    [
        ("FollowPath", 108, "TIMEOUT"),
        ("ComputePathToPose", 208, "NO_VALID_PATH"),
        ("ComputePathThroughPoses", 309, "NO_VIAPOINTS_GIVEN"),
        ("ComputeRoute", 407, "INVALID_EDGE_SCORER_USE"),
        ("ComputeAndTrackRoute", 406, "OPERATION_FAILED"),
        ("SmoothPath", 503, "SMOOTHED_PATH_IN_COLLISION"),
        ("FollowWaypoints", 603, "STOP_ON_MISSED_WAYPOINT"),
        ("Spin", 703, "COLLISION_AHEAD"),
        # The two are the other way round.
        ("BackUp", 713, "INVALID_INPUT"),
        ("BackUp", 714, "COLLISION_AHEAD"),
        ("DriveOnHeading", 723, "COLLISION_AHEAD"),
        ("DriveOnHeading", 724, "INVALID_INPUT"),
        # The same number, another meaning.
        ("DockRobot", 904, "FAILED_TO_DETECT_DOCK"),
        ("FollowObject", 904, "TIMEOUT"),
        ("UndockRobot", 907, "TIMEOUT"),
        ("NavigateThroughPoses", 9101, "FAILED_TO_LOAD_BEHAVIOR_TREE"),
        ("NavigateToPose", 0, "NONE"),
        ("NavigateToPose", 208, "ComputePathToPose NO_VALID_PATH"),
        # Ours, of whatever action.
        ("Spin", 9011, "WORLD_RESTARTED"),
        ("Wait", 4711, "code 4711"),
    ],
)
def test_a_code_has_its_actions_name(action: str, code: int, name: str) -> None:
    assert code_name(action, code) == name


def test_every_code_of_an_action_is_one_of_the_enumeration() -> None:
    known = {int(code) for code in ErrorCode}
    listed = {code for names in ACTION_CODES.values() for code in names} | set(COMMON_CODES)
    assert listed == known
