"""Writes the sources of the message packages that have no wheel: nav2_msgs, simulation_interfaces,
slam_toolbox, tf2_msgs, vision_msgs. Their definitions are those from which the type hashes are
computed.

`python docker/ros2/definitions.py DISTRO FOLDER`, in an environment with the wheels of
requirements-bridge.lock. `packages.py` builds what is in the folder.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path

from mazebot.common.messages.document_types import PACKAGE
from mazebot.common.messages.topics import TOPICS
from mazebot.common.messages.type_hash import definitions_of, messages_of
from mazebot.common.messages.wire import type_name
from mazebot.common.ros.definitions import DISTROS
from mazebot.common.ros.interfaces import interfaces
from mazebot.common.ros.own_services import own_definitions

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
    "# Each file would read the same large headers again. Descriptions use one name in each file.\n"
    "foreach(part generator_c generator_py typesupport_c typesupport_fastrtps_c\n"
    "    typesupport_introspection_c)\n"
    "  set_target_properties(${PROJECT_NAME}__rosidl_${part} PROPERTIES\n"
    "    UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 16)\n"
    "endforeach()\n"
    "get_target_property(descriptions ${PROJECT_NAME}__rosidl_generator_c SOURCES)\n"
    'list(FILTER descriptions INCLUDE REGEX "__description\\\\.c$")\n'
    "set_source_files_properties(${descriptions} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)\n"
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
        if not (Path(sys.prefix) / "share" / package / "package.xml").exists():
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


def main() -> None:
    """Write all that are missing."""
    distro, folder = sys.argv[1], Path(sys.argv[2])
    if distro not in DISTROS:
        sys.exit(f"distro: {distro!r}: must be one of {', '.join(DISTROS)}")
    for package, files in missing_packages(distro).items():
        write_package(folder / package, package, files)


if __name__ == "__main__":
    main()
