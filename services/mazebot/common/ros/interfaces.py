"""ROS 2's services and actions of one distribution: hashes, messages from plain values, CDR."""

from __future__ import annotations

import functools
import re
import struct
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from rosbags.interfaces import Nodetype

from mazebot.common.messages import cdr, wire
from mazebot.common.messages import messages as msg
from mazebot.common.messages.type_hash import definitions_of, hash_by_messages, messages_of
from mazebot.common.ros.definitions import DISTROS, OTHER_SIMULATION
from mazebot.common.ros.own_services import own_definitions

DEFAULT_DISTRO = "jazzy"


class Versioned(dict[str, Any]):
    """Values of a message whose fields differ by distribution: those are left out that a version
    does not have.
    """


_FIELD = re.compile(r"(?P<type>[\w/]+)(?P<list>\[(?P<at_most><=)?(?P<size>\d*)\])?\s+(?P<name>\w+)")
_BASES = {
    "bool", "byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64",
    "uint64", "float32", "float64", "string",
}  # fmt: skip
_HASHED_ALSO = (
    "service_msgs/msg/ServiceEventInfo", "unique_identifier_msgs/msg/UUID",
    "builtin_interfaces/msg/Time",
)  # fmt: skip


class Interfaces:
    """The types of services and actions, as one distribution of ROS 2 has them. A type is named as
    in ROS 2: `std_srvs/srv/Empty`, `nav2_msgs/action/Spin_SendGoal_Request`.

    Values of messages are plain: mappings by field, lists, numbers and texts; what is left out is
    zero, and an orientation that is left out turns nothing.
    """

    def __init__(self, distro: str = DEFAULT_DISTRO) -> None:
        self._distro = distro
        self._texts: dict[str, str] = {}
        for name, text in {**DISTROS[distro], **own_definitions()}.items():
            self._texts |= messages_of(name, text)
        self._hashes: dict[str, str] = {}

    def hash_of(self, name: str) -> str:
        """The type hash of a service, or of a message or a service of an action."""
        found = self._hashes.get(name)
        if found is None:
            found = self._hashes[name] = hash_by_messages(name, self.definitions_of(name))
        return found

    def definitions_of(self, name: str) -> dict[str, str]:
        """The .msg texts of a type and of all types in it, by name."""
        found: dict[str, str] = {}
        waiting = [name, *(_HASHED_ALSO if "/msg/" not in name else ())]
        while waiting:
            each = waiting.pop()
            if each in found:
                continue
            if each not in self._texts:
                found |= _shipped(each)
                continue
            found[each] = self._texts[each]
            waiting += [
                field_type
                for field_type, *_ in _fields(each, self._texts[each])
                if field_type not in _BASES
            ]
        return found

    def make(self, name: str, values: Mapping[str, Any]) -> Any:
        """A message of a type. Raises WireError where a value has no such field."""
        return _made(self._registered(name), values)

    def encode(self, name: str, values: Mapping[str, Any]) -> bytes:
        """The CDR bytes of a message. Raises WireError where a value does not fit its field."""
        try:
            return cdr.encode(self._registered(name), self.make(name, values))
        except (AttributeError, TypeError, ValueError, OverflowError, struct.error) as error:
            raise wire.WireError("wrong type", str(error)) from error

    def decode(self, name: str, data: bytes) -> Any:
        """The message in CDR bytes, with valid values. Raises WireError where they are none."""
        return wire.decode_type(self._registered(name), data)

    def read(self, name: str, data: bytes) -> Any:
        """As `decode`, with any values: a response that failed may have empty ones."""
        return wire.read_type(self._registered(name), data)

    def _registered(self, name: str) -> str:
        """The name of a type in the store of types, in which it differs by distribution."""
        if name not in self._texts:
            return name
        key = f"{self._distro}_{name}"
        with msg.REGISTERING:
            if key not in msg.TYPESTORE.fielddefs:
                found: dict[str, Any] = {}
                self._gather(name, found)
                msg.TYPESTORE.register(found)
        return key

    def _gather(self, name: str, found: dict[str, Any]) -> None:
        """Add a type, and those in it that the message library does not ship, to `found`."""
        fields: list[tuple[str, tuple[Nodetype, Any]]] = []
        found[f"{self._distro}_{name}"] = ([], fields)
        for kind, list_of, size, field in _fields(name, self._texts[name]):
            item: tuple[Nodetype, Any] = (Nodetype.BASE, (kind, 0))
            if kind not in _BASES:
                ours = f"{self._distro}_{kind}" if kind in self._texts else kind
                if kind in self._texts and ours not in found:
                    self._gather(kind, found)
                item = (Nodetype.NAME, ours)
            if list_of is not None:
                item = (list_of, (item, size))
            fields.append((field, item))
        if not fields:
            empty = (Nodetype.BASE, ("uint8", 0))
            fields.append(("structure_needs_at_least_one_member", empty))


def _fields(name: str, text: str) -> list[tuple[str, Nodetype | None, int, str]]:
    """Type with its package, the kind of list if it is one, its fixed or greatest length, and name
    of fields.
    """
    found = []
    for line in filter(None, map(str.strip, text.splitlines())):
        match = _FIELD.fullmatch(line)
        if match is None:
            raise ValueError(f"{name}: {line!r:.80}: must be a type and a name")
        kind = match["type"]
        if kind not in _BASES:
            package, _, short = kind.rpartition("/")
            if "/" not in package:
                kind = f"{package or name.partition('/')[0]}/msg/{short}"
        list_of = None
        if match["list"] is not None:
            is_fixed = match["size"] and not match["at_most"]
            list_of = Nodetype.ARRAY if is_fixed else Nodetype.SEQUENCE
        found.append((kind, list_of, int(match["size"] or 0), match["name"]))
    return found


@functools.cache
def _shipped(name: str) -> Mapping[str, str]:
    return definitions_of(name)


def _made(type_name: str, values: Any) -> Any:
    """A message of a type in the store; one that is given as such is returned."""
    if not isinstance(values, Mapping):
        return values
    fields = msg.TYPESTORE.fielddefs[type_name][1]
    if isinstance(values, Versioned):
        values = {name: values[name] for name, _ in fields if name in values}
    unknown = values.keys() - {name for name, _ in fields}
    if unknown:
        raise wire.WireError("wrong type", f"{type_name}: no field {', '.join(sorted(unknown))}")
    if type_name == "geometry_msgs/msg/Quaternion" and not values:
        values = {"w": 1.0}
    made = {
        name: _value(kind, what, values[name]) if name in values else _zero(kind, what)
        for name, (kind, what) in fields
    }
    return msg.TYPESTORE.types[type_name](**made)


def _value(kind: Nodetype, what: Any, value: Any) -> Any:
    if kind is Nodetype.NAME:
        return _made(what, value)
    if kind is Nodetype.BASE:
        return value
    item_kind, item = what[0]
    if item_kind is Nodetype.NAME:
        return [_made(item, each) for each in value]
    return list(value) if item[0] == "string" else np.ascontiguousarray(value, np.dtype(item[0]))


def _zero(kind: Nodetype, what: Any) -> Any:
    if kind is Nodetype.NAME:
        return _made(what, {})
    if kind is Nodetype.BASE:
        name = what[0]
        if name == "string":
            return ""
        return False if name == "bool" else 0.0 if name.startswith("float") else 0
    item_kind, item = what[0]
    length = cast("int", what[1]) if kind is Nodetype.ARRAY else 0
    if item_kind is Nodetype.NAME or item[0] == "string":
        return [_zero(item_kind, item) for _ in range(length)]
    return np.zeros(length, np.dtype(item[0]))


@functools.cache
def interfaces(distro: str = DEFAULT_DISTRO) -> Interfaces:
    """Those of a distribution, made once."""
    return Interfaces(distro)


def served_as(service_type: str, distro: str) -> tuple[Interfaces, ...]:
    """The forms in which a service is answered: that of the distribution, and of
    simulation_interfaces, which people also build from its sources, that of the other version where
    it is another type.
    """
    of_distro = interfaces(distro)
    if service_type.startswith("simulation_interfaces/srv/"):
        other = interfaces(OTHER_SIMULATION[distro])
        if other.hash_of(service_type) != of_distro.hash_of(service_type):
            return of_distro, other
    return (of_distro,)
