"""Prints the hashes of a folder of .msg, .srv and .action files, such as `PACKAGE/msg/NAME.msg`, as
ROS 2's own generator makes them: {type: hash}. Runs in .venv-ros2.
"""

from __future__ import annotations

import contextlib
import json
import re
import sys
import tempfile
from pathlib import Path

from rosidl_adapter.action import convert_action_to_idl
from rosidl_adapter.msg import convert_msg_to_idl
from rosidl_adapter.srv import convert_srv_to_idl
from rosidl_generator_type_description import generate_type_hash

CONVERSIONS = {
    "msg": convert_msg_to_idl, "srv": convert_srv_to_idl, "action": convert_action_to_idl
}  # fmt: skip
WITHIN = {
    "msg": set(),
    "srv": {"service_msgs", "builtin_interfaces"},
    "action": {"service_msgs", "builtin_interfaces", "unique_identifier_msgs"},
}
"""Packages of types that are in every type of a kind."""


def needed_by(folder: Path) -> set[str]:
    """The packages that the types of one package need."""
    files = [file for kind in CONVERSIONS for file in folder.glob(f"{kind}/*.{kind}")]
    named = {
        name for file in files for name in re.findall(r"^(\w+)/\w+", file.read_text(), re.MULTILINE)
    }
    return named.union(*(WITHIN[file.parent.name] for file in files)) - {folder.name}


def hashes(definitions: Path) -> dict[str, str]:
    """The hash of each type."""
    waiting = {folder.name: needed_by(folder) for folder in definitions.iterdir()}
    found: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as scratch:
        done: list[str] = []
        while waiting:
            package = next(name for name, needs in waiting.items() if needs <= {*done})
            del waiting[package]
            folder = Path(scratch, package)
            tuples = []
            for kind, convert in CONVERSIONS.items():
                (folder / kind).mkdir(parents=True, exist_ok=True)
                for file in definitions.glob(f"{package}/{kind}/*.{kind}"):
                    inside = file.relative_to(definitions / package)
                    convert(file.parent.parent, package, inside, folder / kind)
                    tuples.append(f"{folder}:{kind}/{file.stem}.idl")
            arguments = Path(scratch, "arguments.json")
            content = {
                "package_name": package,
                "output_dir": str(folder),
                "idl_tuples": tuples,
                "include_paths": [f"{name}:{Path(scratch, name)}" for name in done],
            }
            arguments.write_text(json.dumps(content))
            for made in generate_type_hash(str(arguments)):
                for each in json.loads(Path(made).read_text())["type_hashes"]:
                    found[each["type_name"]] = each["hash_string"]
            done.append(package)
    return found


if __name__ == "__main__":
    with contextlib.redirect_stdout(sys.stderr):
        of_all = hashes(Path(sys.argv[1]))
    sys.stdout.write(json.dumps(of_all))
