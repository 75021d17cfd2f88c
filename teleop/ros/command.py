"""Show a running session to ROS 2 nodes, without a bridge.

  teleop ros                                    the session on this machine, domain 0
  teleop ros --set ros.domain=7 --set ros.prefix=/lab --set ros.rate_hz=250
  teleop ros --package ros2_ws/src              writes the ROS package of our messages, and ends
  teleop run --set ros.start=true               with a session

The nodes use the middleware `rmw_zenoh`, and its router runs on this machine. It only listens to
the session: no ROS node changes anything by it. Commands of ROS nodes are taken by the master, if
its device is `{type: ros}`. See docs/how-to/ros.md.
"""

import argparse
import inspect
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from teleop.config.comments import read_field_comments
from teleop.config.options import add_options
from teleop.errors import UsageError
from teleop.link import Link
from teleop.link.ros_session import find_router_problem
from teleop.messages.messages import MESSAGES, SCHEMA_PACKAGE, Head, Message
from teleop.messages.topics import Role
from teleop.ros.arms import RosArm, load_ros_arms
from teleop.ros.config import RosConfig, check_ports
from teleop.ros.message_types import require_rosbags
from teleop.ros.node import RosNode
from teleop.ros.publishers import Publishers
from teleop.runtime.output_file import OutputFolder
from teleop.runtime.process import (
    StopCondition,
    is_supervised,
    lower_priority,
    write_summary,
    write_text_file,
)
from teleop.session.config import RunConfig, read_config

# --- the ROS package of our messages, for `colcon build`, from their declarations

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
    comments = read_field_comments(Head) | read_field_comments(cls)
    lines = [f"# {line}".rstrip() for line in (inspect.getdoc(cls) or "").splitlines()]
    for line in cls.schema.ros_definition.splitlines():
        comment = comments.get(line.rpartition(" ")[2], "")
        lines.append(f"{line}  # {comment}" if comment else line)
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


_POLL_S = 0.5  # [s] between two looks for the router


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop ros`."""
    add_options(parser, "--session", "--config", "--set", "--insecure", "--duration", "--json")
    parser.add_argument(
        "--package",
        type=OutputFolder(SCHEMA_PACKAGE),
        metavar="DIR",
        help="write the ROS package of our messages into DIR, for colcon, and end",
    )


def main(args: argparse.Namespace) -> int:
    """Publish until told to stop; returns the exit code."""
    if args.package is not None:
        print(f"wrote {write_package(args.package)}; build it with colcon")
        return 0
    require_rosbags()
    document = read_config(args)
    run, config = document.load(RunConfig), document.load(RosConfig, "ros")
    check_ports(config.router, run.link)
    lower_priority()
    stop = StopCondition(args.duration)
    sent: dict[str, int] = {}
    if wait_for_router(config.router, stop):
        sent = publish(run, config, stop, load_ros_arms(document, run.arms))
    summary = {"session": run.session, "sent": sent, "reason": stop.reason}
    write_summary(args.json, summary)
    if not is_supervised():
        total = sum(sent.values())
        print(f"ended ({stop.reason}): {total} messages on {sum(map(bool, sent.values()))} topics")
    return 0


def wait_for_router(router: str, stop: StopCondition) -> bool:
    """Wait until the router listens; return False if told to stop before."""
    was_announced = False
    while not stop():
        problem = find_router_problem(router)
        if not problem:
            return True
        if not was_announced:
            print(problem, flush=True)
            was_announced = True
        time.sleep(_POLL_S)
    return False


def publish(
    run: RunConfig, config: RosConfig, stop: StopCondition, arms: tuple[RosArm, ...]
) -> dict[str, int]:
    """Publish until told to stop; return the number of messages by topic."""
    with (
        Link(run.link, run.session, Role.VIEWER) as link,
        RosNode(config.router, config.domain, config.node) as node,
    ):
        publishers = Publishers(link, node, config, lambda text: print(text, flush=True), arms)
        names = f"{config.prefix}/slave/... and {config.prefix}/master/..."
        print(f"session {run.session!r} in ROS domain {config.domain}, as {names}", flush=True)
        publishers.run(stop)
        return publishers.sent
