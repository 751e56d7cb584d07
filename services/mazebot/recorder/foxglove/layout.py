"""Prints layout.json, the layout for Foxglove."""

from __future__ import annotations

import json
import sys

import foxglove.layouts as fl

from mazebot.common.messages import wire
from mazebot.common.messages.topics import (
    CAMERA_COMPRESSED,
    CAMERA_INFO,
    CMD_VEL,
    CMD_VEL_TELEOP,
    FRONTIERS,
    GLOBAL_COSTMAP,
    GOAL_POSE,
    INITIAL_POSE,
    LOCAL_COSTMAP,
    MAP,
    ODOM,
    PARTICLE_CLOUD,
    PLAN,
    ROSOUT,
    SCAN,
    SIMULATION_CONTROL,
    TRAJECTORIES,
)
from mazebot.common.robot.waffle import MAX_ANGULAR_RAD_S, MAX_LINEAR_M_S

_GRID = fl.BaseRendererRosOccupancyGridTopicSettings


def layout_text() -> str:
    """The layout as JSON, for the app's menu `Import from file`."""
    scene = fl.ThreeDeePanel(
        title="World",
        config=fl.ThreeDeeConfig(
            fixed_frame="map",
            follow_tf="map",
            camera_state=fl.ThreeDeeCameraState(perspective=False, distance=14.0, phi=0.0),
            topics={
                MAP.name: _GRID(visible=True, color_mode="map", draw_behind=True),
                GLOBAL_COSTMAP.name: _GRID(visible=False, color_mode="costmap", alpha=0.5),
                LOCAL_COSTMAP.name: _GRID(visible=True, color_mode="costmap", alpha=0.5),
                SCAN.name: fl.BaseRendererLaserScanTopicSettings(visible=True, point_size=3.0),
                PLAN.name: fl.BaseRendererPosesTopicSettings(visible=True, type="line"),
                PARTICLE_CLOUD.name: fl.BaseRendererPosesTopicSettings(visible=True),
                FRONTIERS.name: fl.BaseRendererRosMarkerTopicSettings(visible=True),
                TRAJECTORIES.name: fl.BaseRendererRosMarkerTopicSettings(visible=False),
            },
            publish=fl.ThreeDeePublishSettings(
                type="pose",
                pose_topic=GOAL_POSE.name,
                pose_estimate_topic=INITIAL_POSE.name,
                pose_estimate_x_deviation=0.5,
                pose_estimate_y_deviation=0.5,
                pose_estimate_theta_deviation=0.26,
            ),
        ),
    )
    camera = fl.ImagePanel(
        title="Camera",
        config=fl.ImageConfig(
            image_mode=fl.ImageModeConfig(
                image_topic=CAMERA_COMPRESSED.name,
                image_schema_name=wire.type_name(CAMERA_COMPRESSED),
                calibration_topic=CAMERA_INFO.name,
            )
        ),
    )
    speeds = fl.PlotPanel(
        title="Speed",
        config=fl.PlotConfig(
            paths=[
                fl.PlotSeries(value=f"{CMD_VEL.name}.twist.linear.x", label="commanded, m/s"),
                fl.PlotSeries(value=f"{ODOM.name}.twist.twist.linear.x", label="driven, m/s"),
                fl.PlotSeries(value=f"{CMD_VEL.name}.twist.angular.z", label="commanded, rad/s"),
                fl.PlotSeries(value=f"{ODOM.name}.twist.twist.angular.z", label="driven, rad/s"),
            ]
        ),
    )
    teleop = fl.TeleopPanel(
        title="Drive",
        config=fl.TeleopConfig(
            topic=CMD_VEL_TELEOP.name,
            publish_rate=10.0,
            up_button=fl.TeleopButton(field="linear-x", value=MAX_LINEAR_M_S),
            down_button=fl.TeleopButton(field="linear-x", value=-MAX_LINEAR_M_S),
            left_button=fl.TeleopButton(field="angular-z", value=MAX_ANGULAR_RAD_S / 2.0),
            right_button=fl.TeleopButton(field="angular-z", value=-MAX_ANGULAR_RAD_S / 2.0),
        ),
    )
    pause = fl.ServiceCallPanel(
        title="Simulation",
        config=fl.ServiceCallConfig(
            service_name=SIMULATION_CONTROL.name,
            request_payload=json.dumps({"pause": True}),
            button_text="Send",
        ),
    )
    log = fl.LogPanel(title="Log", config=fl.LogConfig(topic_to_render=ROSOUT.name))
    diagnostics = fl.DiagnosticsSummaryPanel(title="Services")
    layout = fl.Layout(
        content=_split(
            "row",
            (3.0, scene),
            (2.0, _split("column", (3.0, camera), (2.0, speeds), (2.0, log))),
            (1.0, _split("column", (2.0, teleop), (2.0, diagnostics), (2.0, pause),
                         (3.0, fl.ParametersPanel(title="Parameters")))),
        )
    )  # fmt: skip
    return json.dumps(json.loads(layout.to_json()), indent=1) + "\n"


def _split(direction: str, *items: tuple[float, fl.Content]) -> fl.SplitContainer:
    return fl.SplitContainer(
        direction="row" if direction == "row" else "column",
        items=[fl.SplitItem(proportion=share, content=content) for share, content in items],
    )


if __name__ == "__main__":
    sys.stdout.write(layout_text())
