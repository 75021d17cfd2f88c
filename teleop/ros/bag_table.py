"""Read a rosbag2 as measured data: JointState and WrenchStamped as the columns of a table.

Rows are the messages of one JointState topic: the one that ends in `actuators/measured_js`, or else
the only one. Its joints, in the order of their names in the first message, are tendons 1, 2, ...:
positions [m] become displacements and efforts [N] tensions at the housing. What is measured at the
tip comes from the topic that ends in `bench/measured_js`; in bags without `actuators/measured_js`,
from the x component of the only WrenchStamped topic. It is interpolated linearly to the rows, and
rows before its first or after its last message are left out. Each signal is a column of its own as
well, such as `/arm/measured_js/elbow/effort` and `/sensor/measured_cf/force_z`, for `--column`.

Times are those of the headers, or of the bag where headers have none.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from mcap.exceptions import McapError
from mcap.reader import make_reader
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.units import LINEAR
from teleop.data.channel_names import standard
from teleop.errors import UsageError
from teleop.recording.names import SESSION_METADATA
from teleop.recording.scan import RecordingError, Scan
from teleop.ros import cdr
from teleop.ros.standard import JointState, WrenchStamped

ACTUATORS, BENCH = "actuators/measured_js", "bench/measured_js"
_TYPES: dict[str, type[Any]] = {cls.ros_name: cls for cls in (JointState, WrenchStamped)}
_AXES = "xyz"
_MOTION = ("position", "velocity", "effort")


class Signals(NamedTuple):
    """The signals of one topic."""

    times: NDArray[np.int64]  # [ns since the Unix epoch]
    values: dict[str, Array]  # by name, such as elbow/effort or force_x

    @property
    def joints(self) -> list[str]:
        """The joints, in their order."""
        return [name.rpartition("/")[0] for name in self.values if name.endswith("/position")]


class Distal(NamedTuple):
    """What is measured at the tip."""

    topic: str
    times: NDArray[np.int64]
    columns: dict[str, Array]


def is_bag(path: Path) -> bool:
    """Return whether this is a rosbag2, and no recording of ours."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    scan = Scan(path)
    next(scan.blocks(), None)  # our metadata come before the first messages
    if scan.damage:
        raise RecordingError(f"{path}: is damaged {scan.damage}; nothing could be read")
    return SESSION_METADATA not in scan.metadata


def read_bag(path: Path) -> dict[str, NDArray[Any]]:
    """Return the columns of a bag, a folder or one MCAP file; `UsageError` if it has no data."""
    joints: dict[str, Signals] = {}
    wrenches: dict[str, Signals] = {}
    for topic, messages in _messages(path).items():
        if isinstance(messages[0][1], JointState):
            joints[topic] = _joint_signals(messages)
        else:
            wrenches[topic] = _wrench_signals(messages)
    main = _main_topic(path, joints)
    for topic, signals in (joints | wrenches).items():
        if topic != main and (np.diff(signals.times) <= 0).any():
            raise UsageError(f"{path}: times of {topic} do not increase")
    rows = joints[main].times
    distal = _distal(main, joints, wrenches)
    keep = np.ones(len(rows), dtype=bool)
    if distal is not None:
        keep = (rows >= distal.times[0]) & (rows <= distal.times[-1])
        if not keep.any():
            raise UsageError(f"{path}: {main} and {distal.topic} have no time in common")
    rows = rows[keep]
    time_s = (rows - rows[0]) * 1e-9

    def sampled(times: NDArray[np.int64], values: Array) -> Array:
        at_s = (times - rows[0]) * 1e-9
        return np.asarray(np.interp(time_s, at_s, values, np.nan, np.nan), dtype=np.float64)

    columns: dict[str, NDArray[Any]] = {"time_s": time_s}
    for number, name in enumerate(joints[main].joints, start=1):
        for end, what in (("tension", "effort"), ("displacement", "position")):
            column = standard(LINEAR, f"proximal_{end}", number)
            columns[column] = joints[main].values[f"{name}/{what}"][keep]
    if distal is not None:
        columns |= {name: sampled(distal.times, v) for name, v in distal.columns.items()}
    for topic, signals in (joints | wrenches).items():
        for name, values in signals.values.items():
            columns[f"{topic}/{name}"] = sampled(signals.times, values)
    return {name: values for name, values in columns.items() if not np.isnan(values).all()}


def _distal(
    main: str, joints: Mapping[str, Signals], wrenches: Mapping[str, Signals]
) -> Distal | None:
    bench = [topic for topic in joints if topic.endswith(BENCH) and topic != main]
    if len(bench) == 1:
        signals, columns = joints[bench[0]], dict[str, Array]()
        for number, name in enumerate(signals.joints, start=1):
            for end, what in (("tension", "effort"), ("displacement", "position")):
                column = standard(LINEAR, f"distal_{end}", number)
                columns[column] = signals.values[f"{name}/{what}"]
        return Distal(bench[0], signals.times, columns)
    if not main.endswith(ACTUATORS) and len(wrenches) == 1:  # else it may be an estimate of ours
        ((topic, signals),) = wrenches.items()
        columns = {standard(LINEAR, "distal_tension"): signals.values["force_x"]}
        return Distal(topic, signals.times, columns)
    return None


def _main_topic(path: Path, joints: Mapping[str, Signals]) -> str:
    actuators = [topic for topic in joints if topic.endswith(ACTUATORS)]
    topics = actuators or list(joints)
    if len(topics) == 1:
        return topics[0]
    if not topics:
        raise UsageError(f"{path}: has no sensor_msgs/msg/JointState messages")
    raise UsageError(
        f"{path}: has several JointState topics ({', '.join(sorted(topics))}), none of which is "
        f"the only .../{ACTUATORS}; keep one of them: ros2 bag convert"
    )


def _messages(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Return (log time [ns], message) of all topics of the two types."""
    found: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    for file in _files(path):
        try:
            with file.open("rb") as stream:
                for schema, channel, message in make_reader(stream).iter_messages():
                    cls = None if schema is None else _TYPES.get(schema.name)
                    if cls is not None and channel.message_encoding == "cdr":
                        entry = (message.log_time, cdr.decode(cls, message.data))
                        found[channel.topic].append(entry)
        except (McapError, cdr.CdrError) as error:
            raise UsageError(f"{file}: is damaged: {error}") from error
    return found


def _files(path: Path) -> Iterator[Path]:
    """Yield the MCAP files of a bag."""
    if not path.is_dir():
        yield path
        return
    try:
        content = yaml.safe_load((path / "metadata.yaml").read_text())
        names = [str(n) for n in content["rosbag2_bagfile_information"]["relative_file_paths"]]
    except (yaml.YAMLError, KeyError, TypeError, UnicodeError) as error:
        raise UsageError(f"{path}/metadata.yaml: is not that of a rosbag2") from error
    for name in names:
        if not name.endswith(".mcap"):
            raise UsageError(
                f"{path}: {name} is not an MCAP file; convert the bag to storage mcap without "
                "compression: ros2 bag convert"
            )
        yield path / Path(name).name


def _times(messages: list[tuple[int, Any]]) -> NDArray[np.int64]:
    stamps = np.array([message.header.stamp.ns for _, message in messages])
    return stamps if (stamps > 0).all() else np.array([log_ns for log_ns, _ in messages])


def _joint_signals(messages: list[tuple[int, Any]]) -> Signals:
    """Return the signals of each joint named by the first message; NaN where missing."""
    names = dict.fromkeys(messages[0][1].name)
    out = {f"{name}/{what}": np.full(len(messages), np.nan) for name in names for what in _MOTION}
    for row, (_, message) in enumerate(messages):
        for what in _MOTION:
            for name, value in zip(message.name, getattr(message, what), strict=False):
                if name in names:
                    out[f"{name}/{what}"][row] = value
    return Signals(_times(messages), out)


def _wrench_signals(messages: list[tuple[int, Any]]) -> Signals:
    out = {
        f"{what}_{axis}": np.array(
            [getattr(getattr(message.wrench, what), axis) for _, message in messages]
        )
        for what in ("force", "torque")
        for axis in _AXES
    }
    return Signals(_times(messages), out)
