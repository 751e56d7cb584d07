"""The rotation shim: the controller behind it drives, and turns by itself where the shim would."""

from typing import Any

import pytest

from mazebot.common.nav2_params.report import Report
from tests.common.nav2_params.files import config_of, refused, row_of, told

SHIM = {"plugin": "nav2_rotation_shim_controller::RotationShimController"}
RPP = "nav2_regulated_pure_pursuit_controller::RegulatedPurePursuitController"
MPPI = "nav2_mppi_controller::MPPIController"
DWB = "dwb_core::DWBLocalPlanner"


def server(primary: str, own: dict[str, Any], behind: dict[str, Any], nested: bool) -> Any:
    """The controller server with a shim, as since Lyrical (nested) or as up to Kilted."""
    inner: dict[str, Any] = {"primary_controller": primary, **behind}
    if nested:
        inner = {"primary_controller": {"plugin": primary, **behind}}
    return {"controller_plugins": ["F"], "F": SHIM | own | inner}


def both(primary: str, own: dict[str, Any], behind: dict[str, Any]) -> tuple[Report, Report]:
    flat, nested = (
        told("controller_server", server(primary, own, behind, form)) for form in (False, True)
    )
    return flat, nested


@pytest.mark.parametrize(
    ("primary", "behind", "controller"),
    [
        (RPP, {"desired_linear_vel": 0.2, "use_rotate_to_heading": False, "stateful": True,
               "rotate_to_heading_min_angle": 0.1}, "regulated_pure_pursuit"),
        (MPPI, {"vx_max": 0.2, "critics": ["CostCritic"], "prune_distance": 1.2}, "mppi"),
        (DWB, {"max_vel_x": 0.2, "sim_time": 1.7}, "mppi"),
        ("nav2_graceful_controller::GracefulController", {"v_linear_max": 0.2, "beta": 0.4},
         "mppi"),
        ("mine::Magic", {"max_vel_x": 0.2, "magic": 1.0}, "mppi"),
    ],
)  # fmt: skip
def test_both_forms_of_a_shim_are_the_same(
    primary: str, behind: dict[str, Any], controller: str
) -> None:
    own = {
        "angular_dist_threshold": 0.5, "rotate_to_heading_angular_vel": 0.9,
        "max_angular_accel": 1.1, "rotate_to_goal_heading": True, "simulate_ahead_time": 1.0,
    }  # fmt: skip
    flat, nested = both(primary, own, behind)
    assert flat.settings == nested.settings
    assert flat.counts == nested.counts
    assert flat.counts["unknown"] == 0
    for name in behind:
        one, other = row_of(flat, f"F.{name}"), row_of(nested, f"F.primary_controller.{name}")
        assert one.note == other.note.replace("F.primary_controller.", "F.")
    params = config_of(nested).controller_server
    assert params.controller == controller
    assert params.max_angular_accel == 1.1
    assert 0.2 in {params.max_linear_vel, params.mppi.vx_max}
    drives: Any = getattr(params, controller)
    assert drives.rotate_to_heading_min_angle == 0.5
    assert drives.rotate_to_heading_angular_vel == 0.9


def test_pure_pursuit_behind_a_shim_turns_towards_the_path_whatever_its_own_switch_says() -> None:
    for found in both(RPP, {}, {"use_rotate_to_heading": False}):
        assert config_of(found).controller_server.regulated_pure_pursuit.use_rotate_to_heading
        (row,) = [row for row in found.rows if row.parameter.endswith("use_rotate_to_heading")]
        assert (row.status, row.differs) == ("mapped", False)
        assert "the shim before it turns the robot towards the path" in row.note
    alone = {"controller_plugins": ["F"], "F": {"plugin": RPP, "use_rotate_to_heading": False}}
    ours = config_of(told("controller_server", alone)).controller_server.regulated_pure_pursuit
    assert not ours.use_rotate_to_heading


def test_of_the_turns_of_shim_and_controller_the_slower_ones_count() -> None:
    turns = {"rotate_to_heading_angular_vel": 0.6, "max_angular_accel": 0.7}
    fast = {"rotate_to_heading_angular_vel": 1.8, "max_angular_accel": 3.2}
    for own, behind in ((turns, fast), (fast, turns)):
        params = config_of(told("controller_server", server(RPP, own, behind, True)))
        assert params.controller_server.max_angular_accel == 0.7
        ours = params.controller_server.regulated_pure_pursuit
        assert ours.rotate_to_heading_angular_vel == 0.6


def test_what_stands_beside_a_nested_controller_is_not_read() -> None:
    values = server(RPP, {"max_lookahead_dist": 0.7}, {"lookahead_dist": 0.5}, True)
    found = told("controller_server", values)
    assert row_of(found, "F.max_lookahead_dist").status == "unknown"
    assert row_of(found, "F.primary_controller.lookahead_dist").status == "used"


def test_a_nested_controller_may_not_contradict_the_server() -> None:
    values = {"controller_frequency": 5.0, **server(MPPI, {}, {"batch_size": 700}, True)}
    said = refused("controller_server", values)
    assert "F.primary_controller.model_dt: 0.05: must be at least the controller's period" in said


def test_a_controller_that_is_no_shim_stands_before_none() -> None:
    values = {"controller_plugins": ["F"], "F": {"plugin": RPP, "primary_controller": MPPI}}
    found = told("controller_server", values)
    assert config_of(found).controller_server.controller == "regulated_pure_pursuit"
    assert row_of(found, "F.primary_controller").status == "unknown"
