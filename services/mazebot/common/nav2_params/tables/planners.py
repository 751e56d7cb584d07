"""Parameters of the planner server and of the smoother server.

Defaults are those of Nav2's code (nav2_planner, nav2_navfn_planner, nav2_smac_planner,
nav2_theta_star_planner, nav2_smoother), version 1.5.
"""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import Group, namespace

_NAVFN = namespace(
    "navfn",
    """
tolerance double 0.5 >=0
use_astar bool false *
max_cycles_factor double 4.0 >0
allow_unknown bool true *
use_final_approach_orientation bool false *
""",
)

_SMOOTHER = """
smoother.max_iterations int 1000 >=0
smoother.w_smooth double 0.3 >=0
smoother.w_data double 0.2 >=0
smoother.tolerance double 1e-10 >=0
smoother.do_refinement bool true *
smoother.refinement_num int 2 >=0
smoother.enforce_path_inversion bool true *
"""

_SMAC_2D = namespace(
    "smac_2d",
    f"""
tolerance double 0.125 >=0
downsample_costmap bool false *
downsampling_factor int 1 >=1
cost_travel_multiplier double 1.0 >=0
allow_unknown bool true *
max_iterations int 1000000 >=-1 =max_iterations,max_planning_iterations
max_on_approach_iterations int 1000 >=-1
terminal_checking_interval int 5000 >=1
max_planning_time double 2.0 >0
use_final_approach_orientation bool false *
{_SMOOTHER}""",
)

_SMAC_HYBRID = namespace(
    "smac_hybrid",
    f"""
tolerance double 0.25 >=0
downsample_costmap bool false *
downsampling_factor int 1 >=1
angle_quantization_bins int 72 >=1
allow_unknown bool true *
max_iterations int 1000000 >=-1 =max_iterations,max_planning_iterations
max_on_approach_iterations int 1000 >=-1
terminal_checking_interval int 5000 >=1
max_planning_time double 5.0 >0
motion_model_for_search string DUBIN {{DUBIN,REEDS_SHEPP}}
minimum_turning_radius double 0.4 >0
reverse_penalty double 2.0 >=0
change_penalty double 0.0 >=0
non_straight_penalty double 1.2 >=0
rotation_penalty double 5.0 >=0
cost_penalty double 2.0 >=0
retrospective_penalty double 0.015 >=0
analytic_expansion_ratio double 3.5 >0
analytic_expansion_max_length double 3.0 >=0
analytic_expansion_max_cost double 200.0 >=0
analytic_expansion_max_cost_override bool false *
lookup_table_size double 20.0 >0
lattice_filepath string "" *
cache_obstacle_heuristic bool false *
debug_visualizations bool false *
use_quadratic_cost_penalty bool false *
downsample_obstacle_heuristic bool true *
allow_primitive_interpolation bool false *
allow_reverse_expansion bool false *
coarse_search_resolution int 4 >=1
goal_heading_mode string DEFAULT {{DEFAULT,BIDIRECTIONAL,ALL_DIRECTION}}
use_final_approach_orientation bool false *
smooth_path bool true *
{_SMOOTHER}""",
    note="the robot rotates in place: no planner with a turning radius is needed",
)

_THETA_STAR = namespace(
    "theta_star",
    """
how_many_corners int 8 {4,8}
allow_unknown bool true *
w_euc_cost double 1.0 >=0
w_traversal_cost double 2.0 >=0
terminal_checking_interval int 5000 >=1
use_final_approach_orientation bool false *
""",
)

PLANNER_SERVER = namespace(
    "planner_server",
    """
planner_plugins strings [GridBased] * =-
expected_planner_frequency double 1.0 >=0
costmap_update_timeout double 1.0 >=0
allow_partial_planning bool false *
""",
    [
        Group(
            "planner_plugins",
            {
                "NavfnPlanner": _NAVFN, "SmacPlanner2D": _SMAC_2D, "SmacPlanner": _SMAC_HYBRID,
                "SmacPlannerHybrid": _SMAC_HYBRID, "SmacPlannerLattice": _SMAC_HYBRID,
                "ThetaStarPlanner": _THETA_STAR,
            },
            defaults={"GridBased": "NavfnPlanner"},
            setting="planner",
            values={
                "NavfnPlanner": "a_star",
                "SmacPlanner2D": "a_star",
                "ThetaStarPlanner": "any_angle",
            },
        )
    ],
)  # fmt: skip

_SIMPLE = namespace(
    "simple_smoother",
    """
tolerance double 1e-10 >=0
max_its int 1000 >=0
w_data double 0.2 >=0
w_smooth double 0.3 >=0
do_refinement bool true *
refinement_num int 2 >=0
enforce_path_inversion bool true *
""",
)
_SAVITZKY_GOLAY = namespace(
    "savitzky_golay_smoother",
    """
do_refinement bool true *
refinement_num int 2 >=0
enforce_path_inversion bool true *
window_size int 7 >=1
poly_order int 3 >=0
""",
)
_CONSTRAINED = namespace(
    "constrained_smoother",
    """
reversing_enabled bool true *
path_downsampling_factor int 1 >=1
path_upsampling_factor int 1 >=0
keep_start_orientation bool true *
keep_goal_orientation bool true *
minimum_turning_radius double 0.4 >=0
w_curve double 30.0 >=0
w_cost double 0.015 >=0
w_dist double 0.0 >=0
w_smooth double 2000000.0 >=0
cost_check_points doubles [] *
optimizer.linear_solver_type string SPARSE_NORMAL_CHOLESKY *
optimizer.max_iterations int 100 >=0
optimizer.debug_optimizer bool false *
optimizer.gradient_tol double 5000.0 >=0
optimizer.fn_tol double 1e-15 >=0
optimizer.param_tol double 1e-20 >=0
""",
)

SMOOTHER_SERVER = namespace(
    "smoother_server",
    """
smoother_plugins strings [simple_smoother] * =-
transform_tolerance double 0.1 >=0
robot_base_frame string base_link * !base_footprint|base_link
costmap_topic string global_costmap/costmap_raw *
footprint_topic string global_costmap/published_footprint *
""",
    [
        Group(
            "smoother_plugins",
            {
                "SimpleSmoother": _SIMPLE, "SavitzkyGolaySmoother": _SAVITZKY_GOLAY,
                "ConstrainedSmoother": _CONSTRAINED,
            },
            defaults={"simple_smoother": "SimpleSmoother"},
        )
    ],
    note="the planner smooths its own paths",
)  # fmt: skip
