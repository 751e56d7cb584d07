"""Parameters of localisation and of map servers.

Defaults are those of Nav2's code (nav2_amcl/src/amcl_node.cpp, nav2_map_server), version 1.5.
"""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import namespace

_MODELS = "{likelihood_field,likelihood_field_prob,beam}"

AMCL = namespace(
    "localization",
    f"""
alpha1 double 0.2 >=0
alpha2 double 0.2 >=0
alpha3 double 0.2 >=0
alpha4 double 0.2 >=0
alpha5 double 0.2 >=0 # noise of a robot that moves sideways
base_frame_id string base_footprint * !base_footprint|base_link
odom_frame_id string odom * !odom
global_frame_id string map * !map
scan_topic string scan * !scan
map_topic string map * !map
laser_model_type string likelihood_field {_MODELS} !likelihood_field|likelihood_field_prob
max_beams int 60 >=2
laser_max_range double 100.0 >=-1 =:lidar_max_range
laser_min_range double -1.0 >=-1 =:lidar_min_range
laser_likelihood_max_dist double 2.0 >0
sigma_hit double 0.2 >0
z_hit double 0.5 0..1
z_rand double 0.5 0..1
- z_short z_max lambda_short # of the beam model only
do_beamskip bool false * =-
- beam_skip_distance beam_skip_threshold beam_skip_error_threshold
max_particles int 2000 >=1
min_particles int 500 >=1
pf_err double 0.05 >0
pf_z double 0.99 >0
resample_interval int 1 >=1
recovery_alpha_fast double 0.0 0..1 =:gain
recovery_alpha_slow double 0.0 0..1 =:gain
update_min_d double 0.25 >=0
update_min_a double 0.2 >=0
robot_model_type string nav2_amcl::DifferentialMotionModel * !nav2_amcl::DifferentialMotionModel
set_initial_pose bool false *
initial_pose.x double 0.0 *
initial_pose.y double 0.0 *
initial_pose.z double 0.0 * !0.0
initial_pose.yaw double 0.0 *
- always_reset_initial_pose first_map_only
- save_pose_rate saved_pose_filepath # the pose is not saved to a file
initialize_at_saved_pose bool false * !false
tf_broadcast bool true * !true
- transform_tolerance freespace_downsampling
- random_seed # the seed is --seed; runs with the same seed are identical
""",
)

_MAP = "maps come from the world, or from --map of a command"

MAP_SERVER = namespace(
    "map_server",
    """
topic_name string map * !map
frame_id string map * !map
- yaml_filename
""",
    note=_MAP,
)

_MASK_SERVER = """
yaml_filename string "" *
frame_id string map * !map
topic_name string map *"""

KEEPOUT_MASK_SERVER = namespace(
    "navigation.keepout_filter_mask_server", f"{_MASK_SERVER} !keepout_filter_mask"
)
SPEED_MASK_SERVER = namespace(
    "navigation.speed_filter_mask_server", f"{_MASK_SERVER} !speed_filter_mask"
)
MASK_SERVER = namespace(
    "filter_mask_server",
    "frame_id string map * !map\n- yaml_filename topic_name",
    note="masks are those of keepout_filter_mask_server and speed_filter_mask_server",
)

_FILTER_INFO = """
- filter_info_topic
mask_topic string filter_mask *"""

KEEPOUT_FILTER_INFO = namespace(
    "keepout_costmap_filter_info_server",
    f"""{_FILTER_INFO} !keepout_filter_mask
type int 0 {{0,1,2,3}} =- !0
base double 0.0 * =- !0.0
multiplier double 1.0 * =- !1.0
""",
)
SPEED_FILTER_INFO = namespace(
    "navigation.speed_costmap_filter_info_server",
    f"""{_FILTER_INFO} !speed_filter_mask
type int 0 {{0,1,2,3}}
base double 0.0 *
multiplier double 1.0 *
""",
    as_nav2=True,
)
FILTER_INFO = namespace(
    "costmap_filter_info_server",
    "- filter_info_topic mask_topic type base multiplier",
    note="masks are those of keepout_filter_mask_server and speed_filter_mask_server",
)

MAP_SAVER = namespace(
    "map_saver",
    """
- save_map_timeout free_thresh_default occupied_thresh_default map_subscribe_transient_local
""",
    note=_MAP,
)
