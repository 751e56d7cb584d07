"""The messages that the user publishes."""

from typing import cast

from mazebot.cli.topics.publishing import message_at
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import EXPLORE_RESUME, GOAL_POSE, Topic


def test_a_message_without_a_header_is_as_it_is_given() -> None:
    assert message_at(cast("Topic[object]", EXPLORE_RESUME), {"data": True}, 5) == msg.Bool(
        data=True
    )
    assert message_at(cast("Topic[object]", EXPLORE_RESUME), {}, 5) == msg.Bool(data=False)


def test_a_stamp_and_a_frame_that_are_missing_are_filled_in() -> None:
    goal = message_at(cast("Topic[object]", GOAL_POSE), {}, 2_000_000_005)
    assert isinstance(goal, msg.PoseStamped)
    assert goal.header == msg.header(2_000_000_005, "map")
