"""Work with recordings.

  teleop recordings to-ros2 recordings/demo.mcap --out demo_bag       a rosbag2 for ros2 bag
  teleop recordings to-ros2 FILE --out BAG --rate 100 --prefix /lab   less of it, under a prefix

The bag has the topics of `teleop ros` (docs/ros.md), and what a bench measured at the tip as
slave/bench/measured_js.
"""

import argparse
from pathlib import Path

from teleop.errors import UsageError
from teleop.recording.reader import open_recording
from teleop.recording.replay import print_doubts, require_present_layout
from teleop.ros.bag_writer import BagWriter
from teleop.ros.graph import is_name
from teleop.ros.to_bag import convert_recording
from teleop.runtime.output_file import NewFolder


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the sub-commands and their options."""
    works = parser.add_subparsers(dest="work", metavar="WORK", required=True)
    to_ros2 = works.add_parser("to-ros2", help="convert a recording to a rosbag2")
    to_ros2.add_argument("file", type=Path, metavar="FILE", help="the recording (.mcap)")
    to_ros2.add_argument(
        "--out", type=NewFolder(), metavar="BAG", required=True, help="folder of the bag, a new one"
    )
    to_ros2.add_argument(
        "--rate", type=float, metavar="HZ", help="at most HZ messages a second of a live topic"
    )
    to_ros2.add_argument("--prefix", default="", help="before topics and frames, such as /lab")


def main(args: argparse.Namespace) -> int:
    """Convert a recording; returns the exit code."""
    if args.rate is not None and not 0.01 <= args.rate <= 10_000:
        raise UsageError(f"--rate {args.rate:g}: allowed are 0.01 to 10000 [Hz]")
    if args.prefix and not is_name(args.prefix):
        raise UsageError(f"--prefix {args.prefix}: must be a name such as /lab")
    info = open_recording(args.file)
    require_present_layout(info)
    print_doubts(info)
    with BagWriter(args.out) as bag:
        convert_recording(info, bag, args.prefix, 0.0 if args.rate is None else 1.0 / args.rate)
    total = sum(bag.counts.values())
    print(f"wrote {args.out}: {total} messages on {len(bag.counts)} topics, {info.seconds:.1f} s")
    return 0
