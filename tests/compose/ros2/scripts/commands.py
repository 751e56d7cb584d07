"""A node of ROS 2 with rclpy calls services, sets parameters and sends goals; it prints JSON."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped
from mazebot_msgs.srv import SimulationControl
from nav2_msgs.action import NavigateToPose
from nav2_msgs.srv import ClearEntireCostmap, SaveMap
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.node import Node
from simulation_interfaces.srv import GetEntities, SetSimulationState, SpawnEntity
from slam_toolbox.srv import SaveMap as SaveSlamMap
from slam_toolbox.srv import SerializePoseGraph
from std_msgs.msg import String

DEADLINE_S = 100.0
CRATE: dict[str, Any] = {
    "kind": "body", "name": "crate", "position_m": [-1.6, -1.1, 0.15],
    "shapes": [{"name": "box", "geometry": {"kind": "box", "size_m": [0.2, 0.2, 0.3]}}],
}  # fmt: skip

POST = (
    '<sdf version="1.9"><model name="post"><static>true</static><link name="link">'
    '<collision name="c"><geometry><cylinder><radius>0.1</radius><length>0.4</length></cylinder>'
    "</geometry></collision></link></model></sdf>"
)
ROBOT = '<robot name="arm"><link name="no_shape"/></robot>'


class User(Node):  # type: ignore[misc]
    """Someone's own node."""

    def wait(self, condition: Callable[[], bool], wanted: str) -> None:
        """Spin until a condition holds."""
        end_s = time.monotonic() + DEADLINE_S
        while not condition():
            if time.monotonic() > end_s:
                sys.exit(f"{wanted}: not within {DEADLINE_S:g} s")
            rclpy.spin_once(self, timeout_sec=0.1)

    def result(self, future: Any, wanted: str) -> Any:
        """What a future gives."""
        self.wait(future.done, wanted)
        return future.result()

    def call(self, kind: Any, name: str, /, **fields: Any) -> Any:
        """The response of a service."""
        client = self.create_client(kind, name)
        assert client.wait_for_service(DEADLINE_S), name
        return self.result(client.call_async(kind.Request(**fields)), f"the response of {name}")

    def drive(
        self, actions: ActionClient[Any, Any, Any], x_m: float, y_m: float, cancels: bool = False
    ) -> dict[str, Any]:
        """How a goal ended."""
        distances: list[float] = []
        goal = NavigateToPose.Goal()
        goal.pose.header.frame_id = "map"
        goal.pose.pose.position.x, goal.pose.pose.position.y = x_m, y_m
        goal.pose.pose.orientation.w = 1.0
        handle = self.result(
            actions.send_goal_async(
                goal, lambda message: distances.append(message.feedback.distance_remaining)
            ),
            f"whether the goal {x_m, y_m} is accepted",
        )
        ended = handle.get_result_async()
        canceling = None
        if cancels:
            self.wait(lambda: len(distances) > 3 or ended.done(), "feedback")
            canceling = self.result(handle.cancel_goal_async(), "canceling").return_code
        found = self.result(ended, f"the result of the goal {x_m, y_m}, {distances[-3:]} m before")
        return {
            "accepted": handle.accepted,
            "canceling": canceling,
            "distances": distances,
            "status": found.status,
            "code": found.result.error_code,
            "message": found.result.error_msg,
        }


def main() -> None:
    """Print a JSON object with what each has given."""
    rclpy.init()
    user = User("user")
    found: dict[str, Any] = {}
    actions = ActionClient(user, NavigateToPose, "/navigate_to_pose")
    assert actions.wait_for_server(DEADLINE_S)
    costmap = "/global_costmap/clear_entirely_global_costmap"
    found["cleared"] = str(user.call(ClearEntireCostmap, costmap))
    saved = user.call(SaveMap, "/map_saver/save_map", map_topic="map", map_url="kitchen")
    found["saved"] = [saved.result]
    name = String(data="office")
    found["saved"].append(user.call(SaveSlamMap, "/slam_toolbox/save_map", name=name).result)
    graph = user.call(SerializePoseGraph, "/slam_toolbox/serialize_map", filename="hall").result
    found["saved"].append(graph)
    found["spawned"] = []
    for name, resource in (("crate", json.dumps(CRATE)), ("post", POST), ("arm", ROBOT)):
        place = PoseStamped()
        place.pose.position.x, place.pose.position.y, place.pose.position.z = CRATE["position_m"]
        place.pose.position.y -= 0.5 * len(found["spawned"])
        spawned = user.call(
            SpawnEntity,
            "/spawn_entity",
            name=name,
            resource_string=resource,
            initial_pose=place,
        )
        found["spawned"].append([spawned.result.result, spawned.result.error_message])
    found["entities"] = list(user.call(GetEntities, "/get_entities").entities)
    stats = user.call(SimulationControl, "/simulation/control", speed=[1.0]).stats
    found["stats"] = [len(stats), stats[0].paused, stats[0].speed, stats[0].world_hash]
    states = [SetSimulationState.Request(), SetSimulationState.Request()]
    states[0].state.state, states[1].state.state = 2, 1
    found["states"] = [
        user.call(SetSimulationState, "/set_simulation_state", state=each.state).result.result
        for each in states
    ]
    names = ["max_vel_x"]
    speeds = [
        Parameter(
            name="max_vel_x",
            value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value),
        )
        for value in (-1.0, 0.3)
    ]
    set_ = user.call(SetParameters, "/navigation/set_parameters", parameters=speeds).results
    found["set"] = [[one.successful, one.reason] for one in set_]
    got = user.call(GetParameters, "/navigation/get_parameters", names=names)
    found["got"] = [one.double_value for one in got.values]
    found["canceled"] = user.drive(actions, *GOAL, cancels=True)
    found["reached"] = user.drive(actions, *GOAL)
    found["outside"] = user.drive(actions, 50.0, 50.0)
    found["nodes"] = sorted(user.get_node_names())
    sys.stdout.write(json.dumps(found))
    sys.stdout.flush()
    # Fast DDS takes seconds to end.
    os._exit(0)


GOAL = (0.0, 0.0)

if __name__ == "__main__":
    main()
