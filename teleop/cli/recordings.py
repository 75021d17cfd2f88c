"""Convert recordings for other programs: a table, a dataset for learning, a rosbag2.

  teleop recordings to-table run.mcap --out run.parquet        pandas.read_parquet, polars, MATLAB
  teleop recordings to-table run.mcap --out part.csv.gz --from 10 --to 20 --rate 100
  teleop recordings to-lerobot a.mcap b.mcap --out pegs --task "put the peg in"   LeRobotDataset
  teleop recordings to-ros2 run.mcap --out bag                 ros2 bag, named as by teleop ros

What is in a recording: `teleop data show run.mcap`. Recordings are only read. `teleop recordings
WORK --help` explains the columns and frames.
"""

import argparse
import re
from pathlib import Path

from teleop.errors import UsageError
from teleop.runtime.output_file import TABLE_SUFFIXES, NewFolder, OutputFile
from teleop.runtime.process import print_warning

_TO_TABLE = """\
Write a recording as a table, one row a state of the slave (1 kHz as a rule).

  time_s, time_unix_ns         when it was sent, on the slave's clock
  slave_state, slave_reason    such as engaged, none; master_state, master_reason likewise
  position_0_m                 estimated travel of the tip of joint 0
  force_0_N, force_low_0_N, force_high_0_N, status_0   its force, certified interval, status bits
  command_position_0_m, command_velocity_0_m_per_s     newest command, received command_age_s before
  hand_position_0_m, hand_velocity_0_m_per_s, hand_force_0_N   newest hand, hand_age_s before
  event                        what happened since the row before
"""
_TO_LEROBOT = """\
Write recordings as a LeRobotDataset v3.0: action = commanded travel, observation.state = travel,
observation.force, observation.force_low and observation.force_high = force with its interval.

An episode lasts while the slave is engaged, the clutch included. With --marks TEXT one begins at
each event whose text contains TEXT, and lasts until the next.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the sub-commands and their options."""
    works = parser.add_subparsers(dest="work", metavar="WORK", required=True)
    raw = argparse.RawDescriptionHelpFormatter
    to_table = works.add_parser(
        "to-table",
        help="convert a recording to CSV or Parquet",
        description=_TO_TABLE,
        formatter_class=raw,
    )
    _add_file(to_table)
    to_table.add_argument(
        "--out",
        type=OutputFile(*TABLE_SUFFIXES),
        metavar="FILE",
        required=True,
        help="the table: .csv, .csv.gz or .parquet (smallest, and fastest to read)",
    )
    to_table.add_argument(
        "--from", dest="begin_s", type=float, metavar="S", help="rows from S seconds on"
    )
    to_table.add_argument("--to", dest="end_s", type=float, metavar="S", help="rows before S")
    to_table.add_argument(
        "--rate", type=float, metavar="HZ", help="the first row of each 1/HZ seconds only"
    )
    to_lerobot = works.add_parser(
        "to-lerobot",
        help="convert recordings to a LeRobotDataset v3.0",
        description=_TO_LEROBOT,
        formatter_class=raw,
    )
    to_lerobot.add_argument(
        "files", type=Path, nargs="+", metavar="FILE", help="the recordings (.mcap), in order"
    )
    to_lerobot.add_argument(
        "--out", type=NewFolder(), metavar="FOLDER", required=True, help="the dataset, a new folder"
    )
    to_lerobot.add_argument(
        "--task", metavar="TEXT", required=True, help="what is done, for policies that read it"
    )
    to_lerobot.add_argument(
        "--repo-id", metavar="NAME", help="name, such as lab/pegs (default: that of the folder)"
    )
    to_lerobot.add_argument(
        "--fps", type=int, default=50, metavar="HZ", help="frames a second (50)"
    )
    to_lerobot.add_argument(
        "--marks", default="", metavar="TEXT", help="episodes begin at events with TEXT"
    )
    to_ros2 = works.add_parser("to-ros2", help="convert a recording to a rosbag2")
    _add_file(to_ros2)
    to_ros2.add_argument(
        "--out", type=NewFolder(), metavar="BAG", required=True, help="folder of the bag, a new one"
    )
    to_ros2.add_argument(
        "--rate", type=float, metavar="HZ", help="at most HZ messages a second of a live topic"
    )
    to_ros2.add_argument("--prefix", default="", help="before topics and frames, such as /lab")


def _add_file(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FILE", help="the recording (.mcap)")


def main(args: argparse.Namespace) -> int:
    """Convert recordings; returns the exit code."""
    if args.work == "to-table":
        return _write_table(args)
    if args.work == "to-lerobot":
        return _write_dataset(args)
    from teleop.ros.to_bag import write_bag

    return write_bag(args.file, args.out, args.prefix, args.rate)


def _write_table(args: argparse.Namespace) -> int:
    from teleop.data.file_formats import write_batches
    from teleop.data.recording_table import RecordingBatches

    batches = RecordingBatches(args.file, begin_s=args.begin_s, end_s=args.end_s, rate_hz=args.rate)
    write_batches(args.out, batches)
    for line in batches.list_doubts():
        print_warning(line)
    print(f"wrote {args.out}: {batches.rows} rows, {batches.joints} joints")
    return 0


def _write_dataset(args: argparse.Namespace) -> int:
    from teleop.data.lerobot import write_dataset

    if not 1 <= args.fps <= 1000:
        raise UsageError(f"--fps {args.fps}: allowed are 1 to 1000 [Hz]")
    if not args.task.strip() or not args.task.isprintable():
        raise UsageError("--task: must be text on one line, such as --task 'put the peg in'")
    repo_id = args.repo_id or args.out.resolve().name
    if not re.fullmatch(r"[\w.-]+(/[\w.-]+)?", repo_id):
        raise UsageError(f"--repo-id {repo_id}: must be a name such as pegs or lab/pegs")
    summary = write_dataset(args.out, args.files, repo_id, args.fps, args.task, args.marks)
    for line in (*summary.doubts, *(f"left out: {line}" for line in summary.left_out)):
        print_warning(line)
    if summary.held:
        print_warning(
            f"{summary.held} frames repeat the one before: states are missing, or --fps is above "
            "the rate of the slave"
        )
    seconds = summary.frames / args.fps
    print(
        f"wrote {args.out}: {summary.episodes} episodes, {summary.frames} frames at {args.fps} Hz "
        f"({seconds:.0f} s), {summary.joints} joints"
    )
    print(f"read it: LeRobotDataset({repo_id!r}, root={str(args.out)!r})")
    return 0
