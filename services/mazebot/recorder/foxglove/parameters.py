"""The parameters of all services, and those that can be set while they run."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from typing import Any

from foxglove.websocket import Parameter
from pydantic import ValidationError

from mazebot.common.client.robot import Robot, RobotError
from mazebot.common.config import ConfigError, one_line
from mazebot.common.messages import documents as doc
from mazebot.common.messages.topics import SIMULATION_CONTROL

ANSWER_TIMEOUT_S = 10.0
_SIMULATION: Mapping[str, tuple[str, str]] = {
    # Of SimulationStats, and of SimulationControl.
    "simulation.paused": ("paused", "pause"),
    "simulation.speed": ("speed", "speed"),
}


class RunParameters:
    """Named `service.field`, as in config.yaml; those that can be set at run time,
    `simulation.paused` and `simulation.speed`, have no service.
    """

    def __init__(self, robot: Robot | None) -> None:
        self._robot = robot
        self._lock = threading.Lock()
        self._values: dict[str, dict[str, Any]] = {}
        self._stats: doc.SimulationStats | None = None

    def take(self, parameters: doc.Parameters) -> None:
        """The parameters of a service."""
        with self._lock:
            self._values[parameters.service] = dict(_flat(parameters.service, parameters.values))

    def take_stats(self, stats: doc.SimulationStats) -> None:
        """The state of the simulation."""
        self._stats = stats

    def of(self, service: str) -> list[Parameter]:
        """Those of a service."""
        with self._lock:
            return [_parameter(*item) for item in self._values.get(service, {}).items()]

    def get(self, names: list[str]) -> list[Parameter]:
        """Those of some names, of none all; an unknown one is left out."""
        with self._lock:
            values = {name: value for one in self._values.values() for name, value in one.items()}
        stats = self._stats
        if stats is not None:
            values |= {name: getattr(stats, of) for name, (of, _) in _SIMULATION.items()}
        return [
            _parameter(name, value) for name, value in values.items() if not names or name in names
        ]

    def set(self, parameter: Parameter) -> None:
        """Set one of those that can be; returns when it is.

        Raises ConfigError, one line, where it cannot.
        """
        name, value = parameter.name, parameter.get_value()
        if name not in _SIMULATION:
            raise ConfigError(
                f"{name}: is read at start: only {' and '.join(_SIMULATION)} can be set now"
            )
        if self._robot is None:
            raise ConfigError(f"{name}: this run takes no requests")
        field = _SIMULATION[name][1]
        if value is None:
            # A client may unset a parameter; of the simulator that would ask for no change.
            must = "true or false" if field == "pause" else "a number"
            raise ConfigError(f"{name}: None: must be {must}")
        try:
            request = doc.SimulationControl.model_validate({field: value})
        except ValidationError as error:
            raise ConfigError(f"{name}: {one_line(error)}") from error
        reply = self._robot.ask(SIMULATION_CONTROL, request, ANSWER_TIMEOUT_S)
        if reply.error:
            raise RobotError(f"{name}: {reply.error}")
        if reply.stats is not None:
            self.take_stats(reply.stats)


def _flat(prefix: str, values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(f"{prefix}.{name}", value)
        else:
            yield f"{prefix}.{name}", value


def _parameter(name: str, value: Any) -> Parameter:
    """Foxglove has no empty value, and no lists of several types."""
    if value is None:
        return Parameter(name, value="")
    if isinstance(value, list | tuple):
        return Parameter(name, value=[_item(one) for one in value])
    return Parameter(name, value=value)


def _item(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_item(one) for one in value]
    if isinstance(value, Mapping):
        return {str(name): _item(one) for name, one in value.items()}
    return "" if value is None else value
