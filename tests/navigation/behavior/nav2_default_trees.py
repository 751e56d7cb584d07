"""Trees that are built as Nav2's documentation describes its two default trees, and the one that
follows a point (Lyrical).
"""

from __future__ import annotations

from tests.navigation.behavior.nav2_usage import document


def _clear(which: str) -> str:
    service = f"{which}_costmap/clear_entirely_{which}_costmap"
    return f'<ClearEntireCostmap service_name="{service}"/>'


def _ports(prefix: str) -> str:
    return f'error_code_id="{{{prefix}_error_code}}" error_msg="{{{prefix}_error_msg}}"'


_PLANNER = '<WouldAPlannerRecoveryHelp error_code="{compute_path_error_code}"/>'
_CONTROLLER = '<WouldAControllerRecoveryHelp error_code="{follow_path_error_code}"/>'
_RECOVERIES = f"""
<Sequence>
  <Fallback>{_CONTROLLER}{_PLANNER}</Fallback>
  <ReactiveFallback>
    <GoalUpdated/>
    <RoundRobin>
      <Sequence>{_clear("local")}{_clear("global")}</Sequence>
      <Spin spin_dist="1.57" {_ports("spin")}/>
      <Wait wait_duration="5.0" {_ports("wait")}/>
      <BackUp backup_dist="0.30" backup_speed="0.15" {_ports("backup")}/>
    </RoundRobin>
  </ReactiveFallback>
</Sequence>
"""
_FOLLOW = f"""
<RecoveryNode number_of_retries="1">
  <FollowPath path="{{path}}" controller_id="{{selected_controller}}" {_ports("follow_path")}
    tracking_feedback="{{tracking_feedback}}"/>
  <Sequence>{_CONTROLLER}{_clear("local")}</Sequence>
</RecoveryNode>
"""


def _selector(kind: str, what: str, name: str) -> str:
    return (
        f'<{kind}Selector topic_name="{what}_selector" default_{what}="{name}" '
        f'selected_{what}="{{selected_{what}}}"/>'
    )


def _navigate(hz: str, plan: str) -> str:
    selectors = _selector("Controller", "controller", "FollowPath") + _selector(
        "Planner", "planner", "GridBased"
    )
    return document(f"""
<RecoveryNode number_of_retries="6">
  <PipelineSequence>
    {selectors}
    <RateController hz="{hz}">
      <RecoveryNode number_of_retries="1">
        {plan}
        <Sequence>{_PLANNER}{_clear("global")}</Sequence>
      </RecoveryNode>
    </RateController>
    {_FOLLOW}
  </PipelineSequence>
  {_RECOVERIES}
</RecoveryNode>
""")


NAV_TO_POSE = _navigate(
    "1.0",
    f"""
<Fallback>
  <ReactiveSequence>
    <Inverter><GlobalUpdatedGoal/></Inverter>
    <IsGoalNearby path="{{path}}" proximity_threshold="4.0" max_robot_pose_search_dist="1.5"/>
    <TruncatePathLocal input_path="{{path}}" output_path="{{remaining_path}}"
      distance_forward="-1" distance_backward="0.0"/>
    <ValidatePath path="{{remaining_path}}"/>
  </ReactiveSequence>
  <ComputePathToPose goal="{{goal}}" path="{{path}}" planner_id="{{selected_planner}}"
    {_ports("compute_path")}/>
</Fallback>
""",
)
NAV_THROUGH_POSES = _navigate(
    "0.333",
    f"""
<ReactiveSequence>
  <RemovePassedGoals input_goals="{{goals}}" output_goals="{{goals}}" radius="0.7"
    input_waypoint_statuses="{{waypoint_statuses}}"
    output_waypoint_statuses="{{waypoint_statuses}}"/>
  <ComputePathThroughPoses goals="{{goals}}" path="{{path}}" planner_id="{{selected_planner}}"
    {_ports("compute_path")}/>
</ReactiveSequence>
""",
)
FOLLOW_POINT = document(f"""
<PipelineSequence>
  {_selector("Controller", "controller", "FollowPath")}
  {_selector("Planner", "planner", "GridBased")}
  <RateController hz="1.0">
    <Sequence>
      <GoalUpdater input_goal="{{goal}}" output_goal="{{updated_goal}}">
        <ComputePathToPose goal="{{updated_goal}}" path="{{path}}"
          planner_id="{{selected_planner}}" {_ports("compute_path")}/>
      </GoalUpdater>
      <TruncatePath distance="1.0" input_path="{{path}}" output_path="{{truncated_path}}"/>
    </Sequence>
  </RateController>
  <KeepRunningUntilFailure>
    <FollowPath path="{{truncated_path}}" controller_id="{{selected_controller}}"
      {_ports("follow_path")}/>
  </KeepRunningUntilFailure>
</PipelineSequence>
""")
