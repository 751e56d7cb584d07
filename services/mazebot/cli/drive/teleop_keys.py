"""The keys of `mazebot teleop`: those of turtlebot3_teleop and of teleop_twist_keyboard."""

from __future__ import annotations

from dataclasses import dataclass

from mazebot.common.robot.waffle import MAX_ANGULAR_RAD_S, MAX_LINEAR_M_S

STEP_LINEAR_M_S, STEP_ANGULAR_RAD_S = 0.01, 0.1
"""As turtlebot3_teleop."""
FIRST_PRESS_S = 0.7
"""A key drives for so long after its first press: terminals begin to repeat a held key late."""
REPEAT_S = 0.25
"""A held key drives for so long after its last repetition."""

HELD: dict[str, tuple[int, int]] = {
    "up": (1, 0), "down": (-1, 0), "left": (0, 1), "right": (0, -1),
    "i": (1, 0), ",": (-1, 0), "j": (0, 1), "l": (0, -1),
    "u": (1, 1), "o": (1, -1), "m": (-1, -1), ".": (-1, 1),
}  # fmt: skip
"""Keys that drive while they are held: signs of linear and angular speed."""
STEPPED: dict[str, tuple[int, int]] = {"w": (1, 0), "x": (-1, 0), "a": (0, 1), "d": (0, -1)}
"""Keys that raise or lower a constant velocity."""
STOP_KEYS = ("s", " ", "k")
LEAVE_KEYS = ("q", "\x03", "\x04")
SCALED = {"+": 1.1, "-": 1 / 1.1}
TABLE = """\
while held:    u  i  o       up         w           faster by 0.01 m/s (x: slower)
               j  k  l   left  right    a     d     turn left, right by 0.1 rad/s more
               m  ,  .      down        x           constant velocity
stop: k, s or space    + and -: held keys 10 % faster, slower    quit: q or Ctrl-C
"""

_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}


def split_keys(text: str) -> tuple[list[str], str]:
    """The keys in the text of a terminal, and the start of one that is incomplete."""
    keys = []
    while text:
        if not text.startswith("\x1b"):
            keys.append(text[0])
            text = text[1:]
            continue
        # `ESC [ A`, or `ESC O A` in application mode; with modifiers `ESC [ 1 ; 5 A`.
        if len(text) == 1 or (
            text[1] in "[O" and not any(c.isalpha() or c == "~" for c in text[2:])
        ):
            return keys, text
        if text[1] not in "[O":
            text = text[1:]
            continue
        end = next(i for i in range(2, len(text)) if text[i].isalpha() or text[i] == "~")
        if text[end] in _ARROWS:
            keys.append(_ARROWS[text[end]])
        text = text[end + 1 :]
    return keys, ""


@dataclass
class Teleop:
    """The velocity that the keys command."""

    speed_m_s: float = 0.2
    """Of the held keys."""
    turn_rad_s: float = 1.0
    linear_m_s: float = 0.0
    """The constant velocity."""
    angular_rad_s: float = 0.0
    leaves: bool = False
    """Whether the user quits."""
    _held: str = ""
    _until_s: float = 0.0

    def press(self, key: str, now_s: float) -> None:
        """A key was received; one that is held is received repeatedly."""
        if key in LEAVE_KEYS:
            self.leaves = True
        if key in HELD:
            again = key == self._held and now_s < self._until_s
            self._until_s = now_s + (REPEAT_S if again else FIRST_PRESS_S)
            self._held = key
            self.linear_m_s = self.angular_rad_s = 0.0
        elif key in STEPPED:
            linear, angular = STEPPED[key]
            self._held = ""
            self.linear_m_s = _limited(self.linear_m_s + linear * STEP_LINEAR_M_S, MAX_LINEAR_M_S)
            self.angular_rad_s = _limited(
                self.angular_rad_s + angular * STEP_ANGULAR_RAD_S, MAX_ANGULAR_RAD_S
            )
        elif key in SCALED:
            self.speed_m_s = _limited(self.speed_m_s * SCALED[key], MAX_LINEAR_M_S)
            self.turn_rad_s = _limited(self.turn_rad_s * SCALED[key], MAX_ANGULAR_RAD_S)
        elif key in STOP_KEYS or key in LEAVE_KEYS:
            self._held = ""
            self.linear_m_s = self.angular_rad_s = 0.0

    def command(self, now_s: float) -> tuple[float, float]:
        """Linear and angular speed now."""
        if self._held and now_s >= self._until_s:
            self._held = ""
        if self._held:
            linear, angular = HELD[self._held]
            return linear * self.speed_m_s, angular * self.turn_rad_s
        return self.linear_m_s, self.angular_rad_s


def _limited(value: float, most: float) -> float:
    # Without the rounding ten steps down from 0.1 would not end at 0.
    return round(min(max(value, -most), most), 6)
