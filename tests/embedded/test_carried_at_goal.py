"""A robot that is carried off as it arrives is not at its goal."""

from __future__ import annotations

from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import GOAL_POSE, LOCALIZATION_STATUS, NAVIGATION_RESULT
from mazebot.embedded.session import Session

GOAL = SE2(0.5, -0.9, 2.0)
ELSEWHERE = SE2(2.9, 0.0, 0.5)


def nearly_there(pose: SE2) -> bool:
    return pose.distance_m(GOAL) < 0.06 and abs(wrap_angle(pose.yaw_rad - GOAL.yaw_rad)) < 0.3


def test_the_goal_is_not_reached_where_the_robot_is_carried_off_as_it_arrives() -> None:
    with Session("sim_house", seed=1, camera=False) as session:
        session.run_for(0.5)
        header = msg.header(session.now_ns(), "map")
        pose = msg.pose_from_se2(GOAL)
        with session.watching(NAVIGATION_RESULT) as results:
            session.publish(GOAL_POSE, msg.PoseStamped(header=header, pose=pose))
            while not nearly_there(session.ground_truth()):
                session.run_for(0.1)
                assert session.now_s < 30.0
            session.move_robot(*ELSEWHERE)
            suspect = False
            while not results:
                session.run_for(0.1)
                status = session.latest(LOCALIZATION_STATUS)
                assert status is not None
                suspect |= status.suspect
                assert session.now_s < 90.0
    assert results[0].error_code == 0
    assert session.ground_truth().distance_m(GOAL) < 0.1
    assert suspect
