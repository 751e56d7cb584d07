"""Writes and builds the message packages that have no wheel: nav2_msgs, simulation_interfaces,
slam_toolbox, tf2_msgs, vision_msgs. Their definitions are those from which the type hashes are
computed.

`python docker/ros2/packages.py DISTRO`, in an environment with the wheels of
requirements-bridge.lock, installs them into that environment. Needs g++.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from collections import defaultdict
from pathlib import Path

import numpy as np

from mazebot.common.messages.document_types import PACKAGE
from mazebot.common.messages.topics import TOPICS
from mazebot.common.messages.type_hash import definitions_of, messages_of
from mazebot.common.messages.wire import type_name
from mazebot.common.ros.definitions import DISTROS
from mazebot.common.ros.interfaces import interfaces
from mazebot.common.ros.own_services import own_definitions

PREFIX = Path(sys.prefix)
_BUILT_IN = "/opt/python/cp311-cp311"
"""Where the wheels were built: paths in their CMake files."""
_GENERATORS = (
    "rosidl_cmake", "rosidl_generator_type_description", "rosidl_generator_c",
    "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c", "rosidl_typesupport_c",
    "rosidl_generator_py",
)  # fmt: skip
"""What Python and Fast DDS use; rosidl_default_generators wants a package that no wheel brings."""
_SPARED = (
    "# Those for C++ come along with the packages on which the messages depend; nobody uses them.\n"
    'list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")\n'
)
_JOINED = (
    "# Each file would read the same large headers again.\n"
    "set_target_properties(${PROJECT_NAME}__rosidl_typesupport_fastrtps_c PROPERTIES\n"
    "  UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 16)\n"
)


def missing_packages(distro: str) -> dict[str, dict[str, str]]:
    """The packages of the types on the bus that are not installed: each with its files' texts by
    their paths.
    """
    texts = {**DISTROS[distro], **own_definitions()}
    for name in own_definitions():
        for part in messages_of(name, texts[name]):
            found = interfaces(distro).definitions_of(part)
            texts |= {each: found[each] for each in found if each.startswith(f"{PACKAGE}/msg/")}
    for topic in TOPICS:
        texts |= definitions_of(type_name(topic))
    packages: dict[str, dict[str, str]] = defaultdict(dict)
    for name, text in texts.items():
        package, kind, short = name.split("/")
        if not (PREFIX / "share" / package / "package.xml").exists():
            packages[package][f"{kind}/{short}.{kind}"] = text
    return dict(packages)


def dependencies(package: str, files: dict[str, str]) -> list[str]:
    """The other packages whose types are in these files."""
    found = {
        line.split("/")[0]
        for text in files.values()
        for line in text.splitlines()
        if "/" in line.split(" ")[0]
    }
    if any(path.startswith("action/") for path in files):
        found |= {"action_msgs", "unique_identifier_msgs", "builtin_interfaces"}
    if any(not path.startswith("msg/") for path in files):
        found.add("service_msgs")
    return sorted(found - {package})


def write_package(folder: Path, package: str, files: dict[str, str]) -> None:
    """Write the sources of a package."""
    for path, text in files.items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text)
    needed = dependencies(package, files)
    finds = "\n".join(f"find_package({each} REQUIRED)" for each in (*_GENERATORS, *needed))
    names = "\n  ".join(sorted(files))
    (folder / "CMakeLists.txt").write_text(
        f"cmake_minimum_required(VERSION 3.20)\nproject({package})\n"
        f"find_package(ament_cmake REQUIRED)\n{finds}\n{_SPARED}"
        f"rosidl_generate_interfaces(${{PROJECT_NAME}}\n  {names}\n"
        f"  DEPENDENCIES {' '.join(needed)})\n{_JOINED}ament_package()\n"
    )
    depends = "".join(f"  <depend>{each}</depend>\n" for each in needed)
    (folder / "package.xml").write_text(
        f'<package format="3">\n  <name>{package}</name>\n  <version>0.0.0</version>\n'
        "  <description>The fields that are on the wire</description>\n"
        '  <maintainer email="nobody@example.com">nobody</maintainer>\n'
        f"  <license>Apache-2.0</license>\n{depends}"
        "  <member_of_group>rosidl_interface_packages</member_of_group>\n</package>\n"
    )


def make_wheels_relocatable() -> None:
    """Put this environment's paths in place of those of the machine that built the wheels."""
    replaced = {
        f"{_BUILT_IN}/include/python3.11": sysconfig.get_path("include"),
        f"{_BUILT_IN}/lib/python3.11/site-packages/numpy/_core/include": np.get_include(),
    }
    for file in PREFIX.glob("share/*/cmake/*.cmake"):
        text = file.read_text()
        if _BUILT_IN in text:
            for old, new in replaced.items():
                text = text.replace(old, new)
            file.write_text(text)


def build(source: Path) -> None:
    """Build a package and install it into this environment."""
    made = source / "build"
    environment = {
        **os.environ,
        "PATH": f"{PREFIX / 'bin'}:{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": str(PREFIX),
    }
    configure = [
        "cmake", "-G", "Ninja", "-S", str(source), "-B", str(made), "-DBUILD_TESTING=OFF",
        f"-DCMAKE_PREFIX_PATH={PREFIX}", f"-DCMAKE_INSTALL_PREFIX={PREFIX}",
        f"-DPython3_EXECUTABLE={PREFIX / 'bin/python3'}", "-DPython3_FIND_VIRTUALENV=ONLY",
        "-DCMAKE_BUILD_TYPE=MinSizeRel", "-Wno-author",
    ]  # fmt: skip
    for command in (configure, ["cmake", "--build", str(made), "--target", "install"]):
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"{source.name}: {' '.join(command)}\n{done.stdout[-3000:]}{done.stderr}")


def main() -> None:
    """Build all that are missing."""
    distro = sys.argv[1]
    if distro not in DISTROS:
        sys.exit(f"distro: {distro!r}: must be one of {', '.join(DISTROS)}")
    make_wheels_relocatable()
    packages = missing_packages(distro)
    for number, (package, files) in enumerate(packages.items(), 1):
        sys.stdout.write(f"building {package}: {number} of {len(packages)}\n")
        sys.stdout.flush()
        source = Path(sys.argv[2] if len(sys.argv) > 2 else "/tmp/packages") / package
        write_package(source, package, files)
        build(source)
    (PREFIX / "share" / "mazebot_distro").write_text(f"{distro}\n")


if __name__ == "__main__":
    main()
