"""Writes the ROS 2 package `mazebot_msgs` (`make generate`): the messages and services of Mazebot's
own, for people who build nodes against them with colcon.
"""

from __future__ import annotations

import shutil
import sys
from importlib.metadata import version
from pathlib import Path

from mazebot.common.messages.document_types import PACKAGE, files_of, service_text
from mazebot.common.messages.documents import Document
from mazebot.common.messages.topics import TOPICS
from mazebot.common.ros.own_services import OWN_QUERIES

_CMAKE = """\
cmake_minimum_required(VERSION 3.8)
project({package})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(${{PROJECT_NAME}}
{files}
)
ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""
_MANIFEST = """\
<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>{version}</version>
  <description>Mazebot's own messages and services, generated from its documents</description>
  <maintainer email="nobody@example.com">the Mazebot team</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""


def package_files() -> dict[str, str]:
    """The texts of the package's files, by their paths in it."""
    kinds = (topic.type for topic in TOPICS if issubclass(topic.type, Document))
    asked = [kind for query in OWN_QUERIES for kind in (query.request, query.response)]
    messages = {f"msg/{name}.msg": file.text for name, file in files_of(kinds, asked).items()}
    messages |= {
        f"srv/{query.request.__name__}.srv": service_text(query.request, query.response)
        for query in OWN_QUERIES
    }
    names = "\n".join(f'  "{path}"' for path in messages)
    return {
        "CMakeLists.txt": _CMAKE.format(package=PACKAGE, files=names),
        "package.xml": _MANIFEST.format(package=PACKAGE, version=version("mazebot")),
        **messages,
    }


def write(folder: Path) -> None:
    """Write the package in place of what is in the folder."""
    shutil.rmtree(folder, ignore_errors=True)
    for path, text in package_files().items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
