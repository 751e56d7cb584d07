"""Parameters of the planner server and of the smoother server.

Defaults are those of Nav2's code (nav2_planner, nav2_navfn_planner, nav2_smac_planner,
nav2_theta_star_planner, nav2_smoother), version 1.5.
"""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import Group, namespace

_NAVFN = namespace(
    "GridBased",
    """
tolerance double 0.5 >=0
- use_astar max_cycles_factor allow_unknown use_final_approach_orientation
""",
)

_SMAC = """
- downsample_costmap downsampling_factor allow_unknown max_on_approach_iterations
- terminal_checking_interval max_planning_time use_final_approach_orientation
- smoother.max_iterations smoother.w_smooth smoother.w_data smoother.tolerance
- smoother.do_refinement smoother.refinement_num smoother.enforce_path_inversion
"""

_SMAC_2D = namespace(
    "GridBased",
    f"""{_SMAC}
tolerance double 0.125 >=0
cost_travel_multiplier double 1.0 >=0
max_iterations int 1000000 >=-1
""",
)

_SMAC_HYBRID = namespace(
    "smac_hybrid",
    f"""{_SMAC}
- tolerance angle_quantization_bins max_iterations motion_model_for_search minimum_turning_radius
- reverse_penalty change_penalty non_straight_penalty rotation_penalty cost_penalty
- retrospective_penalty analytic_expansion_ratio analytic_expansion_max_length
- analytic_expansion_max_cost analytic_expansion_max_cost_override lookup_table_size
- lattice_filepath cache_obstacle_heuristic debug_visualizations use_quadratic_cost_penalty
- downsample_obstacle_heuristic allow_primitive_interpolation allow_reverse_expansion
- coarse_search_resolution goal_heading_mode smooth_path
""",
    note="the robot rotates in place: no planner with a turning radius is needed",
)

_THETA_STAR = namespace(
    "GridBased",
    """
- how_many_corners allow_unknown w_euc_cost w_traversal_cost terminal_checking_interval
- use_final_approach_orientation
""",
)

PLANNER_SERVER = namespace(
    "navigation.planner_server",
    """
planner_plugins strings [GridBased] * =-
- expected_planner_frequency costmap_update_timeout allow_partial_planning
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
            setting="/planner_server.planner",
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
tolerance double 1e-10 >=0 =-
- max_its w_data w_smooth do_refinement refinement_num enforce_path_inversion
""",
)
_SAVITZKY_GOLAY = namespace(
    "savitzky_golay_smoother",
    "- do_refinement refinement_num enforce_path_inversion window_size poly_order",
)
_CONSTRAINED = namespace(
    "constrained_smoother",
    """
- reversing_enabled path_downsampling_factor path_upsampling_factor keep_start_orientation
- keep_goal_orientation minimum_turning_radius w_curve w_cost w_dist w_smooth cost_check_points
- optimizer.linear_solver_type optimizer.max_iterations optimizer.debug_optimizer
- optimizer.gradient_tol optimizer.fn_tol optimizer.param_tol
""",
)

SMOOTHER_SERVER = namespace(
    "navigation.smoother_server",
    """
smoother_plugins strings [simple_smoother] * =-
robot_base_frame string base_link * !base_footprint|base_link
- transform_tolerance costmap_topic footprint_topic
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
