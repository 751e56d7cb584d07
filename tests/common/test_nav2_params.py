"""Parameter files of Nav2: names of any distribution, types, ranges, and what becomes of each."""

import typing

import pytest
import yaml
from pydantic import BaseModel, ConfigDict, Field

from mazebot.cli.parsing.known import model_of
from mazebot.common.config import ConfigError
from mazebot.common.files.root import ROOT
from mazebot.common.nav2_params import targets
from mazebot.common.nav2_params.entry import Entry
from mazebot.common.nav2_params.loader import Nav2Params, load_nav2_params
from mazebot.common.nav2_params.parameter import Namespace, Parameter, check
from mazebot.common.nav2_params.renames import RENAMES
from mazebot.common.nav2_params.report import STATUSES, Report, Row, report
from mazebot.common.nav2_params.tables.nodes import NODES
from mazebot.common.robot.waffle import MAX_LINEAR_M_S
from mazebot.common.settings.load import sections
from mazebot.navigation.config import NavigationConfig
from mazebot.physics.config import PhysicsConfig
from tests.common.nav2_files import DISTRIBUTIONS, shipped

MODELS = {section: model_of(section) for section in sections()}


class Critic(BaseModel):
    enabled: bool = True
    cost_weight: float = Field(1.0, ge=0)


class Mppi(BaseModel):
    batch_size: int = Field(2000, ge=50, le=20_000)
    vx_max: float = 0.46
    ax_max: float = 1.0
    CostCritic: Critic = Critic()
    TwirlingCritic: Critic = Critic(enabled=False)
    GoalCritic: Critic = Critic()


class Inflation(BaseModel):
    inflation_radius: float = Field(0.7, gt=0)


class Costmap(BaseModel):
    inflation_layer: Inflation | None = None


class Polygon(BaseModel):
    min_points: int = 4
    points: list[list[float]] = []


class Monitor(BaseModel):
    polygons: typing.Dict[str, Polygon] = {}  # noqa: UP006 - of either spelling


class Smoother(BaseModel):
    max_velocity: tuple[float, float, float] = (0.46, 0.0, 1.9)


class Controllers(BaseModel):
    controller: typing.Literal["mppi", "regulated_pure_pursuit"] = "mppi"
    mppi: Mppi = Mppi()


class Navigation(BaseModel):
    model_config = ConfigDict(extra="forbid")

    controller_server: Controllers = Controllers()
    local_costmap: Costmap = Costmap()
    global_costmap: Costmap = Costmap()
    collision_monitor: Monitor = Monitor()
    velocity_smoother: Smoother = Smoother()


class Localization(BaseModel):
    sigma_hit: float = Field(0.04, gt=0)
    min_particles: int = Field(500, ge=10)
    max_particles: int = 2000
    laser_max_range: float = 3.5
    recovery_alpha_slow: float = Field(0.001, gt=0)
    scan_topic: str = "scan"


OURS: dict[str, type[BaseModel]] = {"navigation": Navigation, "localization": Localization}


def load(**nodes: object) -> Nav2Params:
    tree = {node: {"ros__parameters": values} for node, values in nodes.items()}
    return load_nav2_params(yaml.safe_dump(tree, sort_keys=False), "my.yaml")


def entry_of(params: Nav2Params, said: str) -> Entry:
    (found,) = [entry for entry in params.entries if entry.full_name == said]
    return found


def row_of(told: Report, parameter: str) -> Row:
    (found,) = [row for row in told.rows if f"{row.node}.{row.parameter}" == parameter]
    return found


def refused(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_nav2_params(text, "my.yaml")
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_the_file_of_every_distribution_loads_and_every_parameter_is_counted(
    distribution: str,
) -> None:
    text = shipped(distribution)
    told = report(load_nav2_params(text, "nav2_params.yaml"), MODELS)
    assert len(told.rows) >= 200
    assert sum(told.counts.values()) == len(told.rows)
    assert set(told.counts) == set(STATUSES)
    assert told.counts["used"] > 60
    unknown = [f"{row.node}.{row.parameter}" for row in told.rows if row.status == "unknown"]
    typo = ["docking_server.controller.simulation_step"]
    assert unknown == ([] if distribution in {"humble", "iron"} else typo)
    for section, values in told.settings.items():
        # What comes of it is valid here.
        MODELS[section].model_validate(values)


def test_the_typo_in_the_shipped_file_is_unknown_and_the_right_name_is_given() -> None:
    told = report(load_nav2_params(shipped("lyrical"), "nav2_params.yaml"), MODELS)
    row = row_of(told, "docking_server.controller.simulation_step")
    assert row.status == "unknown"
    assert "did you mean controller.simulation_time_step?" in row.note


def test_names_of_humble_become_those_of_today() -> None:
    params = load_nav2_params(shipped("humble"), "nav2_params.yaml")
    server = params.tree["controller_server"]
    assert server["progress_checker_plugins"] == ["progress_checker"]
    assert "progress_checker_plugin" not in server
    behaviors = params.tree["behavior_server"]
    assert behaviors["local_costmap_topic"] == "local_costmap/costmap_raw"
    assert behaviors["local_frame"] == "odom"
    assert behaviors["global_frame"] == "map"
    assert behaviors["spin"]["plugin"] == "nav2_behaviors::Spin"
    entry = entry_of(params, "behavior_server.costmap_topic")
    assert entry.renamed
    assert "costmap_topic up to Humble, now local_costmap_topic" in entry.note
    assert "built-in nodes need no list" in entry_of(params, "bt_navigator.plugin_lib_names").note


def test_the_recoveries_of_galactic_are_behaviors() -> None:
    params = load(
        recoveries_server={"recovery_plugins": ["turn"], "turn": {"plugin": "nav2_recoveries/Spin"}}
    )
    assert params.tree["behavior_server"]["behavior_plugins"] == ["turn"]
    assert params.tree["behavior_server"]["turn"]["plugin"] == "nav2_behaviors::Spin"


MPPI = {"plugin": "nav2_mppi_controller/MPPIController"}


@pytest.mark.parametrize(
    ("node", "values", "name", "value"),
    [
        ("controller_server", {"FollowPath": MPPI | {"prune_distance": 1.7}},
         "PathHandler.prune_distance", 1.7),
        ("controller_server", {"FollowPath": MPPI | {"motion_model": "DiffDrive"}},
         "FollowPath.motion_model", "diff_drive"),
        ("controller_server", {"FollowPath": MPPI | {"critics": ["PathAngleCritic"],
                               "PathAngleCritic": {"forward_preference": False}}},
         "FollowPath.PathAngleCritic.mode", 1),
        ("controller_server",
         {"FollowPath": {"plugin": "nav2_regulated_pure_pursuit_controller/"
                                   "RegulatedPurePursuitController", "desired_linear_vel": 0.3}},
         "FollowPath.max_linear_vel", 0.3),
        ("controller_server",
         {"FollowPath": {"plugin": "nav2_graceful_controller::GracefulController",
                         "final_rotation": False}},
         "FollowPath.prefer_final_rotation", False),
        ("collision_monitor",
         {"polygons": ["Stop"], "Stop": {"type": "polygon", "action_type": "stop", "max_points": 3,
                                         "points": [0.3, 0.3, 0.3, -0.3, 0.0, 0.0]}},
         "Stop.min_points", 4),
        ("local_costmap", {"plugins": ["w"], "w": {"plugin": "nav2_costmap_2d::StaticLayer"},
                           "map_topic": "/map"}, "w.map_topic", "/map"),
        ("local_costmap", {"plugins": ["l"], "l": {"plugin": "nav2_costmap_2d::ObstacleLayer",
                           "observation_sources": "a b",
                           "b": {"topic": "scan", "obstacle_range": 2.0}}},
         "l.b.obstacle_max_range", 2.0),
        ("docking_server", {"dock_plugins": ["home"], "dock_backwards": True,
                            "home": {"plugin": "opennav_docking::SimpleChargingDock"}},
         "home.dock_direction", "backward"),
        ("docking_server", {"dock_plugins": ["home"], "dock_backwards": False,
                            "home": {"plugin": "opennav_docking::SimpleNonChargingDock"}},
         "home.dock_direction", "forward"),
        ("bt_navigator", {"error_code_names": ["follow_path_error_code"]},
         "error_code_name_prefixes", ["follow_path"]),
        ("bt_navigator", {"goals_blackboard_id": "all"},
         "navigate_through_poses.goals_blackboard_id", "all"),
        ("amcl", {"robot_model_type": "differential"}, "robot_model_type",
         "nav2_amcl::DifferentialMotionModel"),
        ("amcl", {"service_introspection_mode": "metadata"}, "introspection_mode", "metadata"),
    ],
)  # fmt: skip
def test_an_old_name_stands_for_todays(
    node: str, values: dict[str, object], name: str, value: object
) -> None:
    params = load(**{node: values})
    (entry,) = [entry for entry in params.entries if entry.name == name]
    assert (entry.value, entry.knowledge) == (value, "parameter")
    assert entry.renamed
    inner: typing.Any = params.tree[node]
    for part in name.split("."):
        inner = inner[part]
    assert inner == value


def test_the_name_of_today_wins_over_the_old_one() -> None:
    told = report(
        load(controller_server={
            "controller_plugins": ["F"],
            "F": {"plugin": "a::RegulatedPurePursuitController", "desired_linear_vel": 0.1,
                  "max_linear_vel": 0.2},
        }),
        MODELS,
    )  # fmt: skip
    old = row_of(told, "controller_server.F.desired_linear_vel")
    assert (old.status, old.note) == ("unsupported", "F.max_linear_vel is also given, and is used")


def test_every_rename_is_of_a_known_node_and_on_the_page() -> None:
    page = (ROOT / "docs" / "nav2-params.md").read_text()
    for rename in RENAMES:
        assert rename.node in {"", *NODES}, rename
        assert rename.old != rename.new or rename.convert, rename
        for name in (rename.plugin, rename.old, rename.new.rpartition("}.")[2]):
            assert name.removeprefix("*.") in page, rename


def test_defaults_of_nav2_stand_under_the_values_of_the_file() -> None:
    params = load(
        amcl={"sigma_hit": 0.1},
        controller_server={"FollowPath": MPPI | {"temperature": 0.2}},
        local_costmap={"plugins": ["o"], "o": {"plugin": "nav2_costmap_2d::ObstacleLayer",
                                               "observation_sources": "front"}},
    )  # fmt: skip
    amcl = params.tree["amcl"]
    assert (amcl["sigma_hit"], amcl["z_hit"], amcl["max_particles"]) == (0.1, 0.5, 2000)
    mppi = params.tree["controller_server"]["FollowPath"]
    assert (mppi["temperature"], mppi["batch_size"]) == (0.2, 1000)
    assert mppi["CostCritic"]["cost_weight"] == 3.81
    source = params.tree["local_costmap"]["o"]["front"]
    assert (source["inf_is_valid"], source["clearing"]) == (False, False)
    assert "inflation_layer" not in params.tree["local_costmap"]
    assert "planner_server" not in params.tree


def test_every_default_is_valid() -> None:
    def visit(space: Namespace) -> None:
        for row in space.parameters.values():
            if row.default is not None:
                check(row, row.default)
        for group in space.groups:
            for child in group.kinds.values():
                visit(child)

    for node in NODES.values():
        visit(node)


def test_words_for_launch_files_are_false_or_the_default() -> None:
    params = load(
        local_costmap={"filters": ["k"], "k": {"plugin": "nav2_costmap_2d::KeepoutFilter",
                                               "enabled": "KEEPOUT_ZONE_ENABLED"}},
        bt_navigator={"default_nav_to_pose_bt_xml": "$(find-pkg-share nav2_bt_navigator)/a.xml"},
        amcl={"max_beams": "$(var beams)"},
    )  # fmt: skip
    enabled = entry_of(params, "local_costmap.k.enabled")
    assert (enabled.value, enabled.unresolved) == (False, True)
    assert "filled in by a launch file: assumed to be false" in enabled.note
    assert entry_of(params, "bt_navigator.default_nav_to_pose_bt_xml").value is None
    assert entry_of(params, "amcl.max_beams").value == 60


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ("amcl: {ros__parameters: {sigma_hit: -0.1}}",
         "my.yaml:1: amcl.sigma_hit: -0.1: must be greater than 0"),
        ("amcl:\n  ros__parameters:\n    max_beams: many",
         "my.yaml:3: amcl.max_beams: 'many': must be an integer"),
        ("amcl: {ros__parameters: {max_beams: 60.5}}", "60.5: must be an integer"),
        ("amcl: {ros__parameters: {do_beamskip: 1}}", "1: must be true or false"),
        ("amcl: {ros__parameters: {alpha1: .nan}}", "nan: must be a number"),
        ("amcl: {ros__parameters: {z_hit: 1.5}}", "1.5: must be from 0 to 1"),
        ("amcl: {ros__parameters: {sigma_hit: }}", "None: must be a number"),
        ("amcl: {ros__parameters: {laser_model_type: beams}}",
         "'beams': must be one of likelihood_field, likelihood_field_prob, beam"),
        ("amcl: {ros__parameters: {min_particles: 3000}}",
         "my.yaml:1: amcl.min_particles: 3000: must be at most max_particles, 2000"),
        ("amcl: {ros__parameters: {min_particles: 30, max_particles: many}}",
         "amcl.max_particles: 'many': must be an integer"),
        ("velocity_smoother: {ros__parameters: {max_accel: [1.0, 2.0]}}",
         "[1.0, 2.0]: must be a list of 3 numbers"),
        ("velocity_smoother: {ros__parameters: {max_decel: [1.0, 0.0, -2.0]}}",
         "each must be at most 0"),
        ("local_costmap: {local_costmap: {ros__parameters: {width: 4.0}}}",
         "local_costmap.width: 4.0: must be an integer"),
        ("global_costmap: {global_costmap: {ros__parameters: {footprint: '[[0, 1], [1, 0]]'}}}",
         "must be a string of at least 3 points"),
        ("controller_server: {ros__parameters: {controller_frequency: 10.0, FollowPath: "
         "{plugin: 'nav2_mppi_controller::MPPIController', model_dt: 0.05}}}",
         "FollowPath.model_dt: 0.05: must be at least the controller's period, 0.1 s"),
        ("recoveries_server: {ros__parameters: {max_rotational_vel: -1.0}}",
         "recoveries_server.max_rotational_vel: -1.0: must be at least 0"),
        ("amcl: {alpha1: 0.2}", "my.yaml:1: amcl/alpha1: must be a mapping that contains"),
        ("ros__parameters: {alpha1: 0.2}", "must be below the name of a node"),
        ("amcl: {ros__parameters: [1]}", "amcl: ros__parameters: must be a mapping"),
        ("amcl: {ros__parameters: {alpha1: 0.2", "my.yaml:2: not YAML:"),
        ("", "my.yaml: is empty"),
        ("- 1", "my.yaml:1: must be a mapping that contains ros__parameters"),
        ("amcl: {ros__parameters: {[1]: 2}}", "a name must be a string"),
        ("a: &a {<<: *a}", "my.yaml:1: <<: must be followed by a mapping"),
        ("a: &a {b: *a}", "must be a mapping that contains ros__parameters"),
        ("amcl: {ros__parameters: &a {b: *a}}", "must be nested at most 40 deep"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line_with_file_line_name_value_and_what_would_be_right(
    values: str, words: str
) -> None:
    assert words in refused(values)


def test_several_mistakes_are_told_at_once_but_not_all() -> None:
    said = refused(
        "amcl: {ros__parameters: {alpha1: -1.0, alpha2: -1.0, alpha3: -1.0, alpha4: -1.0, "
        "alpha5: -1.0}}"
    )
    assert said.count("must be at least 0") == 4
    assert said.endswith("; and 1 more")


def test_a_controller_that_is_not_taken_is_checked_too() -> None:
    said = refused(
        "controller_server: {ros__parameters: {controller_plugins: [A, B], "
        "A: {plugin: 'a::MPPIController'}, B: {plugin: 'a::MPPIController', batch_size: 0}}}"
    )
    assert "controller_server.B.batch_size: 0: must be at least 1" in said


def test_numbers_are_read_as_ros_reads_them() -> None:
    params = load_nav2_params(
        "smoother_server: {ros__parameters: {simple_smoother: {tolerance: 1e-10}}}\n"
        "amcl: {ros__parameters: {alpha1: 1, initial_pose.x: 2}}",
        "my.yaml",
    )
    assert params.tree["smoother_server"]["simple_smoother"]["tolerance"] == 1e-10
    assert params.tree["amcl"]["alpha1"] == 1.0
    assert params.tree["amcl"]["initial_pose"]["x"] == 2.0


def test_namespaces_anchors_and_doubled_costmaps_are_read() -> None:
    params = load_nav2_params(
        "tb4: {amcl: {ros__parameters: &same {alpha1: 0.1}}}\n"
        "/local_costmap/local_costmap: {ros__parameters: {width: 4}}\n"
        "local_costmap: {local_costmap_client: {ros__parameters: {use_sim_time: true}}}\n"
        "'/**': {ros__parameters: {use_sim_time: true, speed: 3}}\n"
        "map_server: {ros__parameters: }\n",
        "my.yaml",
    )
    assert params.tree["amcl"]["alpha1"] == 0.1
    assert params.tree["local_costmap"]["width"] == 4
    told = report(params, MODELS)
    assert row_of(told, "local_costmap_client.use_sim_time").status == "used"
    assert row_of(told, "/**.use_sim_time").status == "used"
    speed = row_of(told, "/**.speed")
    assert speed.status == "unknown"
    assert speed.note == "no node of Nav2 that matches has such a parameter"


def test_a_name_given_twice_is_said_and_the_last_one_counts() -> None:
    params = load_nav2_params(
        "amcl: {ros__parameters: {alpha1: 0.1}}\namcl: {ros__parameters: {alpha1: 0.3}}", "my.yaml"
    )
    (entry,) = params.entries
    assert (entry.value, entry.leaf.line) == (0.3, 2)
    assert "duplicate" in entry.note


def test_a_parameter_is_used_where_its_setting_exists_and_unsupported_where_not() -> None:
    told = report(
        load(
            amcl={"sigma_hit": 0.1, "max_beams": 30, "scan_topic": "/scan", "map_topic": "/map",
                  "global_frame_id": "world", "recovery_alpha_slow": 0.0}
        ),
        OURS,
    )  # fmt: skip
    rows = {row.parameter: row for row in told.rows}
    assert (rows["sigma_hit"].status, rows["sigma_hit"].setting) == (
        "used", "localization.sigma_hit",
    )  # fmt: skip
    assert (rows["max_beams"].status, rows["max_beams"].note) == (
        "unsupported", "has no setting here",
    )  # fmt: skip
    assert rows["map_topic"].status == "used"
    assert rows["global_frame_id"].note == "is always map here"
    off = rows["recovery_alpha_slow"]
    assert off.status == "unsupported"
    assert "recovery_alpha_slow does not take this value: its own one counts" in off.note
    assert told.settings == {"localization": {"sigma_hit": 0.1, "scan_topic": "/scan"}}


def test_nothing_is_said_where_the_models_do_not_know_the_section() -> None:
    assert report(load(amcl={"sigma_hit": 0.1}), {}).settings == {}


def test_limits_stay_within_the_robots_own() -> None:
    told = report(
        load(
            controller_server={"FollowPath": MPPI | {"vx_max": 0.5, "ax_max": 0.8}},
            velocity_smoother={"max_velocity": [0.3, 0.0, 2.5]},
            amcl={"laser_max_range": 100.0},
        ),
        OURS,
    )
    speed = row_of(told, "controller_server.FollowPath.vx_max")
    assert (speed.status, speed.note) == ("mapped", "converted to 0.46")
    assert row_of(told, "controller_server.FollowPath.ax_max").status == "used"
    ours = told.settings["navigation"]
    assert ours["controller_server"]["mppi"] == {"vx_max": 0.46, "ax_max": 0.8}
    assert ours["velocity_smoother"]["max_velocity"] == [0.3, 0.0, 1.9]
    assert told.settings["localization"] == {"laser_max_range": 3.5}
    plant = PhysicsConfig()
    assert plant.max_linear_speed_m_s == MAX_LINEAR_M_S


def test_minus_one_leaves_the_lidars_own_range() -> None:
    told = report(load(amcl={"laser_max_range": -1.0}), OURS)
    (row,) = told.rows
    assert (row.status, row.note) == ("mapped", "the same as the default here")
    assert told.settings == {}


def test_the_class_of_the_controller_chooses_ours() -> None:
    told = report(load(controller_server={"FollowPath": MPPI}), OURS)
    assert told.settings == {"navigation": {"controller_server": {"controller": "mppi"}}}
    dwb = report(
        load(controller_server={"FollowPath": {"plugin": "dwb_core::DWBLocalPlanner",
                                               "max_vel_x": 0.22}}),
        OURS,
    )  # fmt: skip
    plugin = row_of(dwb, "controller_server.FollowPath.plugin")
    assert plugin.status == "unsupported"
    assert "DWBLocalPlanner is not supported: must be one of MPPIController" in plugin.note
    assert dwb.settings == {"navigation": {"controller_server": {"mppi": {"vx_max": 0.22}}}}


@pytest.mark.parametrize(
    ("plugin", "values", "limits"),
    [
        ("nav2_graceful_controller::GracefulController",
         {"v_linear_max": 0.1, "v_angular_max": 0.6}, {"vx_max": 0.1, "wz_max": 0.6}),
        ("teb_local_planner::TebLocalPlannerROS",
         {"max_vel_x": 0.2, "max_vel_theta": 0.5, "acc_lim_x": 0.4}, {"vx_max": 0.2, "wz_max": 0.5,
                                                                     "ax_max": 0.4}),
        ("vector_pursuit_controller::VectorPursuitController",
         {"desired_linear_vel": 0.15}, {"vx_max": 0.15}),
        # More than the robot can.
        ("my_controllers::Fast", {"max_linear_vel": 3.0}, {"vx_max": 0.46}),
    ],
)  # fmt: skip
def test_the_limits_of_a_controller_that_is_not_here_are_kept(
    plugin: str, values: dict[str, float], limits: dict[str, float]
) -> None:
    given = {"FollowPath": {"plugin": plugin, "own_gain": 7.0, **values}}
    told = report(load(controller_server=given), MODELS)
    assert told.settings == {"navigation": {"controller_server": {"mppi": limits}}}
    for name in values:
        row = row_of(told, f"controller_server.FollowPath.{name}")
        assert row.status == "mapped"
        assert "the controller is not supported: MPPI keeps to its limits" in row.note
    assert row_of(told, "controller_server.FollowPath.own_gain").status in {
        "unsupported",
        "unknown",
    }


def test_checkers_have_the_names_of_the_file() -> None:
    """FollowPath may give them, as in Nav2."""
    told = report(
        load(
            controller_server={
                "goal_checker_plugins": ["precise"],
                "precise": {"plugin": "nav2_controller::SimpleGoalChecker"},
            }
        ),
        MODELS,
    )
    server = told.settings["navigation"]["controller_server"]
    assert server["goal_checker_plugins"] == ["precise"]
    assert "path_handler_plugins" not in server


def test_only_the_first_controller_is_taken() -> None:
    told = report(
        load(controller_server={
            "controller_plugins": ["Slow", "Fast"],
            "Slow": MPPI | {"batch_size": 500}, "Fast": MPPI | {"batch_size": 3000},
        }),
        OURS,
    )  # fmt: skip
    assert told.settings["navigation"]["controller_server"]["mppi"]["batch_size"] == 500
    fast = row_of(told, "controller_server.Fast.batch_size")
    assert (fast.status, fast.note) == (
        "unsupported", "only Slow, the first in controller_plugins, is used",
    )  # fmt: skip


def test_a_plugin_of_the_users_own_is_unsupported_and_not_unknown() -> None:
    told = report(
        load(controller_server={"FollowPath": {"plugin": "mine::Magic", "gain": 3}}), OURS
    )
    row = row_of(told, "controller_server.FollowPath.gain")
    assert (row.status, row.note) == ("unsupported", "Magic is not supported")


def test_the_rotation_shim_shares_its_namespace_with_the_controller_behind_it() -> None:
    params = load(controller_server={"FollowPath": {
        "plugin": "nav2_rotation_shim_controller::RotationShimController",
        "primary_controller": "nav2_mppi_controller::MPPIController",
        "angular_dist_threshold": 0.7, "batch_size": 700,
    }})  # fmt: skip
    assert entry_of(params, "controller_server.FollowPath.batch_size").knowledge == "parameter"
    assert row_of(report(params, OURS), "controller_server.FollowPath.batch_size").status == "used"


def test_critics_that_are_not_listed_are_off() -> None:
    told = report(
        load(controller_server={"FollowPath": MPPI | {
            "GoalCritic": {"enabled": False},
            "critics": ["CostCritic", "GoalCritic", "PathAlignCritic"],
            "TwirlingCritic": {"cost_weight": 3.0},
        }}),
        OURS,
    )  # fmt: skip
    mppi = told.settings["navigation"]["controller_server"]["mppi"]
    assert mppi["CostCritic"]["enabled"] is True
    assert mppi["TwirlingCritic"] == {"enabled": False}
    assert mppi["GoalCritic"]["enabled"] is False
    critics = row_of(told, "controller_server.FollowPath.critics")
    assert (critics.status, critics.note) == ("mapped", "2 of 3 are on; without PathAlignCritic")
    twirling = row_of(told, "controller_server.FollowPath.TwirlingCritic.cost_weight")
    assert "TwirlingCritic is not in critics" in twirling.note


def test_each_costmap_has_its_own_layers_and_each_polygon_its_own_settings() -> None:
    layer = {"plugin": "nav2_costmap_2d::InflationLayer"}
    told = report(
        load(
            local_costmap={"plugins": ["i"], "i": layer | {"inflation_radius": 0.5}},
            global_costmap={"plugins": ["i"], "i": layer | {"inflation_radius": 0.9}},
            collision_monitor={
                "polygons": ["Near", "Far"],
                "Near": {
                    "type": "polygon",
                    "action_type": "stop",
                    "points": "[[0.3, 0.2], [0.3, -0.2], [0, 0]]",
                },
                "Far": {"type": "polygon", "action_type": "approach", "min_points": 7},
                "Spare": {"type": "circle", "radius": 0.5},
            },
        ),
        OURS,
    )
    ours = told.settings["navigation"]
    assert ours["local_costmap"]["inflation_layer"]["inflation_radius"] == 0.5
    assert ours["global_costmap"]["inflation_layer"]["inflation_radius"] == 0.9
    polygons = ours["collision_monitor"]["polygons"]
    assert polygons["Near"]["points"] == [[0.3, 0.2], [0.3, -0.2], [0.0, 0.0]]
    assert polygons["Far"]["min_points"] == 7
    assert row_of(told, "local_costmap.plugins").status == "used"
    spare = row_of(told, "collision_monitor.Spare.radius")
    assert "Spare is not in polygons" in spare.note


def test_two_values_for_one_setting_are_said() -> None:
    spin = {"plugin": "nav2_behaviors::Spin", "max_rotational_vel": 0.9}
    told = report(
        load(behavior_server={"max_rotational_vel": 0.5, "spin": spin}),
        {"navigation": NavigationConfig},
    )
    assert told.settings == {"navigation": {"behavior_server": {"max_rotational_vel": 0.5}}}
    row = row_of(told, "behavior_server.spin.max_rotational_vel")
    assert row.status == "unsupported"
    assert "is already set by behavior_server.max_rotational_vel" in row.note


def test_a_name_is_not_taken_for_a_setting_of_another_place() -> None:
    class Server(BaseModel):
        failure_tolerance: float = 0.3

    class Elsewhere(BaseModel):
        enabled: bool = False
        transform_tolerance: float = 0.1
        inflation_radius: float = 0.7
        controller_server: Server = Server()

    layer = {"plugin": "nav2_costmap_2d::InflationLayer", "enabled": True, "inflation_radius": 0.5}
    told = report(
        load(
            local_costmap={"inflation_layer": layer},
            global_costmap={"transform_tolerance": 0.5},
            controller_server={"failure_tolerance": 0.7},
        ),
        {"navigation": Elsewhere},
    )
    assert told.settings == {"navigation": {"controller_server": {"failure_tolerance": 0.7}}}


def test_unknown_nodes_and_names_come_with_the_nearest_known_one() -> None:
    told = report(load(amlc={"alpha1": 0.1}, amcl={"sigma_hits": 0.1}, ekf={"f": 1}), OURS)
    notes = {row.node: (row.status, row.note) for row in told.rows}
    assert notes["amlc"] == ("unknown", "not a node of Nav2; did you mean amcl?")
    assert notes["ekf"] == ("unknown", "not a node of Nav2")
    assert notes["amcl"][0] == "unknown"
    assert "did you mean sigma_hit?" in notes["amcl"][1]


def test_every_row_with_a_target_names_a_setting_that_exists() -> None:
    """Rows of parameters that change nothing here are names alone."""
    for place, row in _all_rows():
        if row.target and place.startswith(("navigation.", "localization")):
            found = targets.setting(place, row.target, "mine", MODELS)
            assert found or row.fixed, f"{place}: {row.name}: write it as `- {row.name}`"
    used = {row.conversion for _, row in _all_rows()} - {""}
    assert used == set(targets.CONVERSIONS)


def _all_rows() -> list[tuple[str, Parameter]]:
    """Each row, with the place of its setting."""
    found: list[tuple[str, Parameter]] = []

    def visit(space: Namespace, place: str) -> None:
        found.extend((place, row) for row in space.parameters.values())
        for group in space.groups:
            for child in filter(None, (*group.kinds.values(), group.others)):
                visit(child, f"{place}.{child.place}".rstrip("."))

    for node in NODES.values():
        visit(node, node.place)
    return found


def test_masks_and_the_velocity_smoother_are_those_of_navigation() -> None:
    told = report(
        load(
            velocity_smoother={"max_velocity": [0.3, 0.0, 2.5], "max_accel": [2.5, 0.0, 3.2],
                               "scale_velocities": True},
            keepout_filter_mask_server={"yaml_filename": "keepout.yaml"},
            speed_filter_mask_server={"yaml_filename": "speed.yaml"},
            keepout_costmap_filter_info_server={"type": 0, "base": 0.0, "multiplier": 1.0},
            speed_costmap_filter_info_server={"type": 2, "base": 0.0, "multiplier": 0.01},
        ),
        {"navigation": NavigationConfig},
    )  # fmt: skip
    config = NavigationConfig(**told.settings["navigation"])
    smoother = config.velocity_smoother
    assert (smoother.max_velocity, smoother.max_accel) == ((0.3, 0.0, 1.9), (1.0, 0.0, 2.0))
    assert smoother.scale_velocities
    masks = config.keepout_filter_mask_server, config.speed_filter_mask_server
    assert [mask.yaml_filename for mask in masks] == ["keepout.yaml", "speed.yaml"]
    info = config.speed_costmap_filter_info_server
    assert (info.type, info.multiplier) == (2, 0.01)
    assert {row.status for row in told.rows} <= {"used", "mapped"}


@pytest.mark.parametrize(
    ("stated", "expected", "notes"),
    [
        ({"type": 1}, (1, 0.0, 1.0), ("base is left out: 0.0 as in Nav2", "multiplier")),
        ({"type": 2, "multiplier": 0.01}, (2, 0.0, 0.01), ("base is left out: 0.0",)),
        ({"type": 1, "base": 100.0, "multiplier": -1.0}, (1, 100.0, -1.0), ()),
        ({"base": 20.0}, (1, 20.0, 1.0), ("type is left out: 0 as in Nav2, which must be 1 or 2",)),
        # Where a file says nothing of it, ours count.
        ({}, (1, 100.0, -1.0), ()),
    ],
)
def test_what_a_speed_mask_means_is_as_in_nav2(
    stated: dict[str, float], expected: tuple[int, float, float], notes: tuple[str, ...]
) -> None:
    nodes = {"speed_costmap_filter_info_server": stated} if stated else {"amcl": {"alpha1": 0.1}}
    told = report(load(**nodes), {"navigation": NavigationConfig})
    info = NavigationConfig(**told.settings.get("navigation", {})).speed_costmap_filter_info_server
    assert (info.type, info.base, info.multiplier) == expected
    said = "; ".join(row.note for row in told.rows)
    assert all(note in said for note in notes)
    assert ("left out" in said) == bool(notes)


SHIM = """
controller_server:
  ros__parameters:
    controller_plugins: [FollowPath]
    FollowPath:
      plugin: nav2_rotation_shim_controller::RotationShimController
      primary_controller: PRIMARY
      forward_sampling_distance: 0.5
      VALUE
"""


@pytest.mark.parametrize(
    ("primary", "value", "settings"),
    [
        (
            "nav2_regulated_pure_pursuit_controller::RegulatedPurePursuitController",
            "desired_linear_vel: 0.15",
            {"controller": "regulated_pure_pursuit", "max_linear_vel": 0.15},
        ),
        (
            "nav2_mppi_controller/MPPIController",
            "vx_max: 0.2",
            {"controller": "mppi", "mppi": {"vx_max": 0.2}},
        ),
        ("dwb_core::DWBLocalPlanner", "max_vel_x: 0.2", {"mppi": {"vx_max": 0.2}}),
        ("nav2_graceful_controller::GracefulController", "k_phi: 2.0", {}),
        ("teb_local_planner::TebLocalPlannerROS", "max_vel_x: 0.2", {"mppi": {"vx_max": 0.2}}),
    ],
)
def test_a_rotation_shim_is_its_primary_controller(
    primary: str, value: str, settings: dict[str, object]
) -> None:
    text = SHIM.replace("PRIMARY", primary).replace("VALUE", value)
    told = report(load_nav2_params(text, "my.yaml"), MODELS)
    assert told.counts["unknown"] == 0
    assert told.settings.get("navigation", {}).get("controller_server", {}) == settings
    assert row_of(told, "controller_server.FollowPath.plugin").status == "unsupported"
    chosen = row_of(told, "controller_server.FollowPath.primary_controller")
    assert (chosen.status == "mapped") == ("controller" in settings)
    given = row_of(told, f"controller_server.FollowPath.{value.partition(':')[0]}")
    assert (given.status in {"used", "mapped"}) == bool(settings)


def test_the_names_of_a_primary_controller_are_those_of_any_distribution() -> None:
    primary = "nav2_mppi_controller::MPPIController"
    text = SHIM.replace("PRIMARY", primary).replace("VALUE", "prune_distance: 1.2")
    params = load_nav2_params(text, "my.yaml")
    assert params.tree["controller_server"]["PathHandler"]["prune_distance"] == 1.2
    slow = text.replace("controller_plugins", "controller_frequency: 5.0\n    controller_plugins")
    assert "FollowPath.model_dt: 0.05: must be at least the controller's period" in refused(slow)


def test_what_is_repeated_is_told_with_its_line() -> None:
    text = """amcl:
  ros__parameters:
    laser_max_range: 1.0
    laser_max_range: 2.0
velocity_smoother:
  ros__parameters:
    max_velocity: [0.2, 0.0, 1.0]
amcl:
  ros__parameters: {sigma_hit: 0.1}
"""
    told = report(load_nav2_params(text, "my.yaml"), MODELS)
    note = row_of(told, "amcl.laser_max_range").note
    assert "duplicate of line 3, 1.0: the last is used" in note
    assert "amcl is repeated in line 8: both are read" in note
    assert row_of(told, "amcl.sigma_hit").note == ""
    assert row_of(told, "velocity_smoother.max_velocity").note == ""
    merged = "amcl: &a\n  ros__parameters: {sigma_hit: 0.2}\nother:\n  amcl:\n    <<: *a\n"
    merged += "    ros__parameters: {sigma_hit: 0.1}\n"
    assert "repeated" not in row_of(report(load_nav2_params(merged, "my.yaml"), MODELS),
                                    "amcl.sigma_hit").note  # fmt: skip


def test_misplaced_layers_are_told() -> None:
    told = report(
        load(
            local_costmap={
                "plugins": ["inflation_layer", "obstacle_layer"],
                "inflation_layer": {"plugin": "nav2_costmap_2d::InflationLayer"},
                "obstacle_layer": {"plugin": "nav2_costmap_2d::ObstacleLayer"},
                "inflation_radius": 0.5,
            },
            global_costmap={
                "plugins": ["static_layer", "inflation_layer"],
                "static_layer": {
                    "plugin": "nav2_costmap_2d::StaticLayer",
                    "inflation_layer": {"cost_scaling_factor": 3.0},
                },
            },
            controller_server={"inflation_layer": {"inflation_radius": 0.5}},
        ),
        MODELS,
    )
    order = row_of(told, "local_costmap.plugins").note
    assert "inflation_layer should be the last: in Nav2 what obstacle_layer marks is not" in order
    assert "lists no" not in order
    missing = row_of(told, "global_costmap.plugins").note
    assert "lists no ObstacleLayer: there is always one here" in missing
    assert "inflation_layer.plugin is missing: Nav2 does not start without it" in missing
    for parameter, place in (
        ("local_costmap.inflation_radius", "at local_costmap.inflation_layer.inflation_radius"),
        (
            "global_costmap.static_layer.inflation_layer.cost_scaling_factor",
            "at global_costmap.inflation_layer.cost_scaling_factor",
        ),
        (
            "controller_server.inflation_layer.inflation_radius",
            "at local_costmap.inflation_layer.inflation_radius and global_costmap.inflation_layer",
        ),
    ):
        row = row_of(told, parameter)
        assert row.status == "unknown"
        assert f"; it is a parameter {place}" in row.note


@pytest.mark.parametrize(
    ("node", "values", "message"),
    [
        (
            "controller_server",
            {"FollowPath": {
                "plugin": "nav2_regulated_pure_pursuit_controller::RegulatedPurePursuitController",
                "min_lookahead_dist": 0.9, "max_lookahead_dist": 0.3,
            }},
            "FollowPath.min_lookahead_dist: 0.9: must be at most max_lookahead_dist, 0.3",
        ),
        (
            "controller_server",
            {"FollowPath": {"plugin": "nav2_mppi_controller::MPPIController", "vx_min": 0.3,
                            "vx_max": 0.2}},
            "FollowPath.vx_min: 0.3: must be at most vx_max, 0.2",
        ),
        (
            "behavior_server",
            {"min_rotational_vel": 2.0, "max_rotational_vel": 1.0},
            "min_rotational_vel: 2.0: must be at most max_rotational_vel, 1.0",
        ),
        (
            "local_costmap",
            {
                "plugins": ["obstacle_layer"],
                "obstacle_layer": {
                    "plugin": "nav2_costmap_2d::ObstacleLayer", "observation_sources": "scan",
                    "scan": {"raytrace_min_range": 4.0, "raytrace_max_range": 3.0},
                },
            },
            "obstacle_layer.scan.raytrace_min_range: 4.0: must be at most raytrace_max_range, 3.0",
        ),
        (
            "amcl",
            {"laser_min_range": 2.0, "laser_max_range": 1.0},
            "laser_min_range: 2.0: must be at most laser_max_range, 1.0",
        ),
    ],
)  # fmt: skip
def test_a_minimum_over_its_maximum_is_refused(
    node: str, values: dict[str, object], message: str
) -> None:
    error = refused(yaml.safe_dump({node: {"ros__parameters": values}}))
    assert error.startswith("my.yaml:")
    assert f"{node}.{message}" in error


def test_a_maximum_that_is_none_is_below_no_minimum() -> None:
    load(amcl={"laser_min_range": 0.1, "laser_max_range": -1.0})
    load(controller_server={"FollowPath": {"plugin": "x::DWBLocalPlanner", "min_speed_xy": 0.1,
                                           "max_speed_xy": -1.0}})  # fmt: skip


def test_marking_and_clearing_of_a_source_are_those_of_the_file() -> None:
    scan = {"topic": "/scan", "data_type": "LaserScan", "marking": False, "clearing": False}
    layer = {
        "plugin": "nav2_costmap_2d::ObstacleLayer", "observation_sources": "scan", "scan": scan,
    }  # fmt: skip
    costmap = {"plugins": ["obstacle_layer"], "obstacle_layer": layer}
    told = report(load(local_costmap=costmap), {"navigation": NavigationConfig})
    source = told.settings["navigation"]["local_costmap"]["obstacle_layer"]["scan"]
    assert source == {"marking": False, "clearing": False}
    assert row_of(told, "local_costmap.obstacle_layer.scan.marking").status == "used"
