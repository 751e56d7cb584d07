"""The colours of Gazebo's built-in materials, by their names in a <script>."""

from __future__ import annotations

from mazebot.common.messages.documents import Rgba

_GREY = (0.3, 0.3, 0.3, 1.0)

GAZEBO_COLOURS: dict[str, tuple[Rgba, Rgba]] = {
    "Gazebo/Grey": (_GREY, (0.7, 0.7, 0.7, 1.0)),
    "Gazebo/Gray": (_GREY, (0.7, 0.7, 0.7, 1.0)),
    "Gazebo/DarkGrey": ((0.175, 0.175, 0.175, 1.0), (0.175, 0.175, 0.175, 1.0)),
    "Gazebo/DarkGray": ((0.175, 0.175, 0.175, 1.0), (0.175, 0.175, 0.175, 1.0)),
    "Gazebo/White": ((1.0, 1.0, 1.0, 1.0), (1.0, 1.0, 1.0, 1.0)),
    "Gazebo/FlatBlack": ((0.1, 0.1, 0.1, 1.0), (0.1, 0.1, 0.1, 1.0)),
    "Gazebo/Black": ((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)),
    "Gazebo/Red": ((1.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 1.0)),
    "Gazebo/RedBright": ((0.87, 0.26, 0.07, 1.0), (0.87, 0.26, 0.07, 1.0)),
    "Gazebo/Green": ((0.0, 1.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)),
    "Gazebo/Blue": ((0.0, 0.0, 1.0, 1.0), (0.0, 0.0, 1.0, 1.0)),
    "Gazebo/SkyBlue": ((0.13, 0.44, 0.70, 1.0), (0.13, 0.44, 0.70, 1.0)),
    "Gazebo/Yellow": ((1.0, 1.0, 0.0, 1.0), (1.0, 1.0, 0.0, 1.0)),
    "Gazebo/ZincYellow": ((0.9725, 0.9529, 0.2078, 1.0), (0.9725, 0.9529, 0.2078, 1.0)),
    "Gazebo/DarkYellow": ((0.7, 0.7, 0.0, 1.0), (0.7, 0.7, 0.0, 1.0)),
    "Gazebo/Purple": ((1.0, 0.0, 1.0, 1.0), (1.0, 0.0, 1.0, 1.0)),
    "Gazebo/Turquoise": ((0.0, 1.0, 1.0, 1.0), (0.0, 1.0, 1.0, 1.0)),
    "Gazebo/Orange": ((1.0, 0.5088, 0.0468, 1.0), (1.0, 0.5088, 0.0468, 1.0)),
    "Gazebo/Indigo": ((0.33, 0.0, 0.5, 1.0), (0.33, 0.0, 0.5, 1.0)),
    "Gazebo/Gold": ((0.4, 0.24869, 0.020759, 1.0), (0.8, 0.64869, 0.120759, 1.0)),
}
"""Ambient and diffuse, as in gazebo-classic's media/materials/scripts/gazebo.material; those with
a texture (Gazebo/Wood, Gazebo/Bricks, ...) have no colour there.
"""
