"""Mazebot's own messages, where ROS has no type: on topics as those of `mazebot_msgs`, made from
them in `document_types.py`; in queries as JSON in std_msgs/String.

Each one is a frozen pydantic model: unknown keys and non-finite numbers are rejected.
Lengths are metres, angles radians, times seconds of simulation, in the frame `map` unless a name
says otherwise.
"""

# Each file adds its documents to the names here.
from mazebot.common.messages.documents.document import *
from mazebot.common.messages.documents.entities import *
from mazebot.common.messages.documents.entity_requests import *
from mazebot.common.messages.documents.error_statistics import *
from mazebot.common.messages.documents.evaluation import *
from mazebot.common.messages.documents.map_evaluation import *
from mazebot.common.messages.documents.markers import *
from mazebot.common.messages.documents.navigation import *
from mazebot.common.messages.documents.parameters import *
from mazebot.common.messages.documents.places import *
from mazebot.common.messages.documents.rooms import *
from mazebot.common.messages.documents.shapes import *
from mazebot.common.messages.documents.simulation import *
from mazebot.common.messages.documents.walls import *
from mazebot.common.messages.documents.world import *
