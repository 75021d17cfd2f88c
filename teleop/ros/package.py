"""The ROS package of our messages, for `colcon build`, from their declarations."""

import inspect
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from teleop.errors import UsageError
from teleop.messages.messages import MESSAGES, Message
from teleop.messages.page import read_field_comments
from teleop.recording.names import SCHEMA_PACKAGE
from teleop.ros.interface import find_interface
from teleop.runtime.process import write_text_file

_MANIFEST = """<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>{version}</version>
  <description>Messages of tendon-teleop sessions and recordings.</description>
  <maintainer email="nobody@example.org">the authors of tendon-teleop</maintainer>
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
_CMAKE = """cmake_minimum_required(VERSION 3.16)
project({name})

find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)

rosidl_generate_interfaces(${{PROJECT_NAME}}
{files}
)

ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""


def build_package_files() -> dict[str, str]:
    """Return the files of the package: path in it -> text."""
    try:
        number = version("tendon-teleop")
    except PackageNotFoundError:
        number = "0.0.0"
    messages = {cls.schema.name: format_message_file(cls) for cls in MESSAGES}
    files = "\n".join(f'  "msg/{name}.msg"' for name in messages)
    return {
        "package.xml": _MANIFEST.format(name=SCHEMA_PACKAGE, version=number),
        "CMakeLists.txt": _CMAKE.format(name=SCHEMA_PACKAGE, files=files),
        **{f"msg/{name}.msg": text for name, text in messages.items()},
    }


def format_message_file(cls: type[Message]) -> str:
    """Return the `.msg` file of a message, with units and meaning of its fields."""
    comments = read_field_comments(cls)
    lines = [f"# {line}".rstrip() for line in (inspect.getdoc(cls) or "").splitlines()]
    for field in find_interface(cls).fields:
        comment = comments.get(field.name, "")
        lines.append(f"{field.text}  # {comment}" if comment else field.text)
    return "\n".join(lines) + "\n"


def write_package(folder: Path) -> Path:
    """Write the package as a folder in `folder`; `UsageError` if that cannot be."""
    root = folder / SCHEMA_PACKAGE
    try:
        for name, text in build_package_files().items():
            path = root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text_file(path, text, "the package")
    except OSError as error:
        raise UsageError(f"--package {folder}: cannot be written: {error.strerror}") from error
    return root
