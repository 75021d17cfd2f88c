"""Show a running session to ROS 2 nodes, without a bridge.

  teleop ros                                    the session on this machine, domain 0
  teleop ros --set ros.domain=7 --set ros.prefix=/lab --set ros.rate_hz=250
  teleop ros --package ros2_ws/src              writes the ROS package of our messages, and ends
  teleop run --set ros.start=true               with a session

The nodes use the middleware `rmw_zenoh`, and its router runs on this machine. It only listens to
the session: no ROS node changes anything by it. Commands of ROS nodes are taken by the master, if
its device is `{type: ros}`. See docs/ros.md.
"""

import argparse
import time

from teleop.config.options import add_options
from teleop.link import Link
from teleop.link.ros_session import is_router_listening
from teleop.messages.topics import Role
from teleop.recording.names import SCHEMA_PACKAGE
from teleop.ros.config import RosConfig, check_ports
from teleop.ros.node import RosNode
from teleop.ros.package import write_package
from teleop.ros.publishers import Publishers
from teleop.runtime.output_file import OutputFolder
from teleop.runtime.process import StopCondition, is_supervised, lower_priority, write_summary
from teleop.session.config import RunConfig, load_section

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
    run, config = load_section(args, RosConfig, "ros")
    check_ports(config.router, run.link)
    lower_priority()
    stop = StopCondition(args.duration)
    sent: dict[str, int] = {}
    if wait_for_router(config.router, stop):
        sent = publish(run, config, stop)
    summary = {"session": run.session, "sent": sent, "reason": stop.reason}
    write_summary(args.json, summary)
    if not is_supervised():
        total = sum(sent.values())
        print(f"ended ({stop.reason}): {total} messages on {sum(map(bool, sent.values()))} topics")
    return 0


def wait_for_router(router: str, stop: StopCondition) -> bool:
    """Wait until the router listens; return False if told to stop before."""
    said = False
    while not stop():
        if is_router_listening(router):
            return True
        if not said:
            print(f"no router at {router} yet: ros2 run rmw_zenoh_cpp rmw_zenohd", flush=True)
            said = True
        time.sleep(_POLL_S)
    return False


def publish(run: RunConfig, config: RosConfig, stop: StopCondition) -> dict[str, int]:
    """Publish until told to stop; return the number of messages by topic."""
    with (
        Link(run.link, run.session, Role.VIEWER) as link,
        RosNode(config.router, config.domain, config.node) as node,
    ):
        publishers = Publishers(link, node, config, lambda text: print(text, flush=True))
        names = f"{config.prefix}/slave/... and {config.prefix}/master/..."
        print(f"session {run.session!r} in ROS domain {config.domain}, as {names}", flush=True)
        publishers.run(stop)
        return publishers.sent
