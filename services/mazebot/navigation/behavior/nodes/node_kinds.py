"""All node kinds by their names in XML: those of nav2_behavior_tree, and BehaviorTree.CPP's own."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from mazebot.common.config import ConfigError
from mazebot.navigation.behavior.engine.ports import READERS, Port
from mazebot.navigation.behavior.engine.tree import Node, NodeStatus, TreeError
from mazebot.navigation.behavior.nodes import (
    branches,
    controls,
    decorators,
    nodes_behaviors,
    nodes_blackboard,
    nodes_conditions,
    nodes_control,
    nodes_goals,
    nodes_planning,
)
from mazebot.navigation.control.plugins import load_plugin
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.own_class import OwnClass

CONTROLS: Final[Mapping[str, type[Node]]] = MappingProxyType(
    {
        "Sequence": controls.InSequence,
        "SequenceWithMemory": controls.SequenceWithMemory,
        "Fallback": controls.Fallback,
        "ReactiveSequence": controls.ReactiveSequence,
        "ReactiveFallback": controls.ReactiveFallback,
        "PipelineSequence": controls.PipelineSequence,
        "RecoveryNode": controls.RecoveryNode,
        "RoundRobin": controls.RoundRobin,
        "NonblockingSequence": controls.NonblockingSequence,
        "PersistentSequence": controls.PersistentSequence,
        "AsyncSequence": controls.AsyncSequence,
        "AsyncFallback": controls.AsyncFallback,
        "Parallel": branches.Parallel,
        "ParallelAll": branches.ParallelAll,
        "IfThenElse": branches.IfThenElse,
        "WhileDoElse": branches.WhileDoElse,
        **{f"Switch{cases}": branches.switch(cases) for cases in range(2, 7)},
    }
)

DECORATORS: Final[Mapping[str, type[Node]]] = MappingProxyType(
    {
        "Inverter": decorators.Inverter,
        "ForceSuccess": decorators.ForceSuccess,
        "ForceFailure": decorators.ForceFailure,
        "KeepRunningUntilFailure": decorators.KeepRunningUntilFailure,
        "Repeat": decorators.Repeat,
        "RetryUntilSuccessful": decorators.RetryUntilSuccessful,
        "Timeout": decorators.Timeout,
        "RateController": decorators.RateController,
        "DistanceController": decorators.DistanceController,
        "SpeedController": decorators.SpeedController,
        "SingleTrigger": decorators.SingleTrigger,
        "Delay": decorators.Delay,
        "RunOnce": decorators.RunOnce,
        "Precondition": decorators.Precondition,
        "GoalUpdater": decorators.GoalUpdater,
        "GoalUpdatedController": decorators.GoalUpdatedController,
        "PathLongerOnApproach": decorators.PathLongerOnApproach,
        "SkipUnlessUpdated": nodes_blackboard.SkipUnlessUpdated,
        "WaitValueUpdate": nodes_blackboard.WaitValueUpdate,
        "LoopInt": nodes_blackboard.loop("LoopInt", "integer"),
        "LoopBool": nodes_blackboard.loop("LoopBool", "flag"),
        "LoopDouble": nodes_blackboard.loop("LoopDouble", "number"),
        "LoopString": nodes_blackboard.loop("LoopString", "text"),
    }
)

CONDITIONS: Final[Mapping[str, type[Node]]] = MappingProxyType(
    {
        "AreErrorCodesPresent": nodes_conditions.AreErrorCodesPresent,
        "ArePosesNear": nodes_conditions.ArePosesNear,
        "DistanceTraveled": nodes_conditions.DistanceTraveled,
        "GlobalUpdatedGoal": nodes_conditions.GlobalUpdatedGoal,
        "GoalReached": nodes_conditions.GoalReached,
        "GoalUpdated": nodes_conditions.GoalUpdated,
        "IsBatteryLow": nodes_conditions.IsBatteryLow,
        "IsBatteryCharging": nodes_conditions.IsBatteryCharging,
        "InitialPoseReceived": nodes_conditions.InitialPoseReceived,
        "IsGoalNearby": nodes_planning.IsGoalNearby,
        "IsStuck": nodes_conditions.IsStuck,
        "IsWithinPathTrackingBounds": nodes_conditions.IsWithinPathTrackingBounds,
        "PathExpiringTimer": nodes_planning.PathExpiringTimer,
        "TimeExpired": nodes_conditions.TimeExpired,
        "TransformAvailable": nodes_conditions.TransformAvailable,
        "WouldAControllerRecoveryHelp": nodes_conditions.WouldAControllerRecoveryHelp,
        "WouldAPlannerRecoveryHelp": nodes_conditions.WouldAPlannerRecoveryHelp,
        "WouldARouteRecoveryHelp": nodes_conditions.WouldARouteRecoveryHelp,
        "WouldASmootherRecoveryHelp": nodes_conditions.WouldASmootherRecoveryHelp,
        "IsPathValid": nodes_planning.ValidatePath,
        "IsPoseOccupied": nodes_conditions.CheckPoseOccupancy,
        "IsStopped": nodes_conditions.CheckStopStatus,
    }
)

ACTIONS: Final[Mapping[str, type[Node]]] = MappingProxyType(
    {
        "AlwaysSuccess": nodes_conditions.AlwaysSuccess,
        "AlwaysFailure": nodes_conditions.AlwaysFailure,
        "SetBlackboard": nodes_blackboard.SetBlackboard,
        "UnsetBlackboard": nodes_blackboard.UnsetBlackboard,
        "WasEntryUpdated": nodes_blackboard.WasEntryUpdated,
        "Log": nodes_conditions.Log,
        "Script": nodes_conditions.ScriptNode,
        "ScriptCondition": nodes_conditions.ScriptCondition,
        "Sleep": nodes_conditions.Sleep,
        "AppendGoalPoseToGoals": nodes_goals.AppendGoalPoseToGoals,
        "AssistedTeleop": nodes_behaviors.AssistedTeleopNode,
        "BackUp": nodes_behaviors.BackUpNode,
        "CancelControl": nodes_control.cancels("FollowPath"),
        **{
            f"Cancel{action}": nodes_control.cancels(action)
            for action in ("AssistedTeleop", "BackUp", "DriveOnHeading", "Spin", "Wait")
        },
        "CheckPoseOccupancy": nodes_conditions.CheckPoseOccupancy,
        "CheckStopStatus": nodes_conditions.CheckStopStatus,
        "ClearCostmapAroundPose": nodes_control.ClearCostmapAroundPose,
        "ClearCostmapAroundRobot": nodes_control.ClearCostmapAroundRobot,
        "ClearCostmapExceptRegion": nodes_control.ClearCostmapExceptRegion,
        "ClearEntireCostmap": nodes_control.ClearEntireCostmap,
        "ComputePathThroughPoses": nodes_planning.ComputePathThroughPoses,
        "ComputePathToPose": nodes_planning.ComputePathToPose,
        "ConcatenatePaths": nodes_planning.ConcatenatePaths,
        "ControllerSelector": nodes_control.selector("ControllerSelector", "controller"),
        "DockRobot": nodes_behaviors.DockRobotNode,
        "DriveOnHeading": nodes_behaviors.DriveOnHeadingNode,
        "FollowPath": nodes_control.FollowPath,
        "GetCurrentPose": nodes_goals.GetCurrentPose,
        "GetNextFewGoals": nodes_goals.GetNextFewGoals,
        "GetPoseFromPath": nodes_planning.GetPoseFromPath,
        "GoalCheckerSelector": nodes_control.selector("GoalCheckerSelector", "goal_checker"),
        "PathHandlerSelector": nodes_control.selector("PathHandlerSelector", "path_handler"),
        "PlannerSelector": nodes_control.selector("PlannerSelector", "planner"),
        "ProgressCheckerSelector": nodes_control.selector(
            "ProgressCheckerSelector", "progress_checker"
        ),
        "ReinitializeGlobalLocalization": nodes_control.ReinitializeGlobalLocalization,
        "RemoveInCollisionGoals": nodes_goals.RemoveInCollisionGoals,
        "RemovePassedGoals": nodes_goals.RemovePassedGoals,
        "SmoothPath": nodes_planning.SmoothPath,
        "SmootherSelector": nodes_control.selector("SmootherSelector", "smoother"),
        "Spin": nodes_behaviors.SpinNode,
        "ToggleCollisionMonitor": nodes_control.ToggleCollisionMonitor,
        "TruncatePath": nodes_planning.TruncatePath,
        "TruncatePathLocal": nodes_planning.TruncatePathLocal,
        "UndockRobot": nodes_behaviors.UndockRobotNode,
        "ValidatePath": nodes_planning.ValidatePath,
        "Wait": nodes_behaviors.WaitNode,
    }
)

NODE_KINDS: Final[Mapping[str, type[Node]]] = MappingProxyType(
    {**CONTROLS, **DECORATORS, **CONDITIONS, **ACTIONS}
)


def node_class(kind: str) -> type[Node] | None:
    """The class of a node kind, which may be "FILE.py:MyNode" or "my_package.my_module:MyNode";
    None: there is none of that name.

    Raises ConfigError, in one line, where a class of a user's own cannot be loaded.
    """
    if not is_own(kind):
        return NODE_KINDS.get(kind)
    found = load_plugin(kind, Node, "behavior tree node")
    if not issubclass(found, Node):
        raise ConfigError(f"behavior tree node: {kind:.120}: must be derived from Node")
    _check_ports(kind, found.ports)
    return found


def _check_ports(kind: str, ports: object) -> None:
    source = f"behavior tree node: {kind:.120}: ports"
    if not isinstance(ports, tuple):
        raise ConfigError(f"{source}: {ports!r:.80}: must be a tuple of Port, such as (Port('a'),)")
    for port in ports:
        if not isinstance(port, Port) or not isinstance(port.name, str):
            raise ConfigError(f"{source}: {port!r:.80}: must be a Port")
        if port.type not in list(READERS):
            names = ", ".join(READERS)
            raise ConfigError(
                f"{source}: {port.name}: type {port.type!r:.40}: must be one of {names}"
            )


def is_own(kind: str) -> bool:
    """Whether a node kind is a class of a user's own."""
    return ":" in kind


def checked_node(kind: str, node: Node) -> Node:
    """A node, whose calls are checked if its class is a user's own."""
    if not is_own(kind):
        return node
    own, tick, halt = OwnClass("behavior tree node", kind, type(node)), node._tick, node._halt
    if not all(hasattr(node, name) for name in ("place", "children", "status")):
        must = "one that calls super().__init__(place, children)"
        raise own.wrong("__init__", "made no whole node", must)

    def checked_tick(now_ns: int) -> NodeStatus:
        with own.calling("_tick", TreeError, NavigationError):
            status = tick(now_ns)
        if not isinstance(status, NodeStatus) or status is NodeStatus.IDLE:
            raise own.refused("_tick", status, "a NodeStatus, and not IDLE")
        return status

    def checked_halt() -> None:
        with own.calling("_halt", TreeError, NavigationError):
            halt()

    node._tick = checked_tick  # type: ignore[method-assign]
    node._halt = checked_halt  # type: ignore[method-assign]
    return node


_ROUTES = "there is no route graph"
UNSUPPORTED: Final[Mapping[str, str]] = MappingProxyType(
    {
        "ComputeRoute": _ROUTES,
        "ComputeAndTrackRoute": _ROUTES,
        "CancelComputeAndTrackRoute": _ROUTES,
        "ExtractRouteNodesAsGoals": _ROUTES,
        "FollowObject": "object following is not available",
        "CancelFollowObject": "object following is not available",
        "NavigateToPose": "a tree cannot start another task: use a SubTree",
        "NavigateThroughPoses": "a tree cannot start another task: use a SubTree",
        "PauseResumeController": "tasks are paused as a whole",
    }
)
"""Nav2's node kinds that parse but do not run, and why."""

RENAMED_KINDS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "SequenceStar": "SequenceWithMemory",
        "RetryUntilSuccesful": "RetryUntilSuccessful",
        "SubTreePlus": "SubTree",
    }
)
"""Names of nodes in BehaviorTree.CPP's format 3."""

RENAMED_PORTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "robot_frame": "robot_base_frame",
        "max_position_error_left": "max_error_left",
        "max_position_error_right": "max_error_right",
        "max_heading_error": "max_error_heading",
        "input_wapoint_statuses": "input_waypoint_statuses",
        "success_threshold": "success_count",
        "failure_threshold": "failure_count",
    }
)
"""Names of ports in trees of other distributions."""
