"""Read a rosbag2 as measured data: JointState and WrenchStamped as the columns of a table.

Rows are the messages of one JointState topic: the one of which `--column` names a signal, the one
that ends in `actuators/measured_js`, or the only one. Each signal is a column, such as
`/arm/measured_js/elbow/effort` and `/sensor/measured_cf/force_z`, for `--column`. The joints of
`actuators/measured_js`, in the order of their names in the first message, are tendons 1, 2, ...
too: positions [m] become displacements and efforts [N] tensions at the housing. Of other topics
nothing tells whether they are metres and newtons, or radians and newton metres, so the user names
the columns. What is measured at the tip comes from the topic that ends in `bench/measured_js`; in
bags without `actuators/measured_js`, from the x component of the only WrenchStamped topic. It is
interpolated linearly to the rows, and rows before its first or after its last message are left out.

Times are those of the headers, or of the bag where headers have none.
"""

from array import array
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.units import LINEAR
from teleop.config import strict_yaml
from teleop.data import read_limits
from teleop.data.standard_columns import format_standard_name
from teleop.errors import UsageError
from teleop.recording.scan import MESSAGE_HEAD, SESSION_METADATA, Scan
from teleop.ros.message_types import JOINT_STATE, WRENCH_STAMPED, CdrError, decode, to_stamp_ns
from teleop.runtime.process import print_warning

ACTUATORS, BENCH = "actuators/measured_js", "bench/measured_js"
METADATA = "metadata.yaml"
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


class BagTable(NamedTuple):
    """The columns of a bag, and why those of a tendon are not among them, one line or ""."""

    columns: dict[str, NDArray[Any]]
    lacks: str


class DistalColumns(NamedTuple):
    """What is measured at the tip."""

    topic: str
    times: NDArray[np.int64]
    columns: dict[str, Array]


def is_bag(path: Path) -> bool:
    """Return whether this is a rosbag2, and no recording of ours."""
    if path.is_dir():
        return (path / METADATA).is_file() or any(path.glob("*.mcap"))
    scan = Scan(path, loose=True)
    next(scan.read_blocks(), None)  # our metadata come before the first messages
    return SESSION_METADATA not in scan.metadata


def read_bag(path: Path, names: Sequence[str] = ()) -> BagTable:
    """Return the columns of a bag, a folder or one MCAP file; `UsageError` if it has no data.

    The first of `names` that is a signal of a JointState topic tells whose messages the rows are;
    then none of its joints is taken for a tendon that it does not name.
    """
    joints: dict[str, Signals] = {}
    wrenches: dict[str, Signals] = {}
    for topic, recorded in _read_topics(path).items():
        (joints if recorded.type == JOINT_STATE else wrenches)[topic] = recorded.build_signals()
    named = [topic for name in names for topic in joints if name.startswith(f"{topic}/")]
    main = named[0] if named else _find_main_topic(path, joints)
    for topic, signals in (joints | wrenches).items():
        if topic != main and (np.diff(signals.times) <= 0).any():
            raise UsageError(f"{path}: times of {topic} do not increase")
    rows = joints[main].times
    distal = _find_distal_columns(main, {} if named else joints, wrenches)
    keep = np.ones(len(rows), dtype=bool)
    if distal is not None:
        keep = (rows >= distal.times[0]) & (rows <= distal.times[-1])
        if not keep.any():
            raise UsageError(f"{path}: {main} and {distal.topic} have no time in common")
    rows = rows[keep]
    tendons = joints[main].joints if main.endswith(ACTUATORS) and not named else []
    width = 1 + 2 * len(tendons) + (0 if distal is None else len(distal.columns))
    width += sum(len(signals.values) for signals in (joints | wrenches).values())
    # before any column: a topic with few messages has as many rows as the others here
    read_limits.check_size(path, width, len(rows), "keep fewer topics: ros2 bag convert")
    time_s = (rows - rows[0]) * 1e-9

    def sampled(times: NDArray[np.int64], values: Array) -> Array:
        at_s = (times - rows[0]) * 1e-9
        return np.asarray(np.interp(time_s, at_s, values, np.nan, np.nan), dtype=np.float64)

    columns: dict[str, NDArray[Any]] = {"time_s": time_s}
    for number, name in enumerate(tendons, start=1):
        for end, quantity in (("tension", "effort"), ("displacement", "position")):
            column = format_standard_name(LINEAR, f"proximal_{end}", number)
            columns[column] = joints[main].values[f"{name}/{quantity}"][keep]
    if distal is not None:
        columns |= {name: sampled(distal.times, v) for name, v in distal.columns.items()}
    for topic, signals in (joints | wrenches).items():
        for name, values in signals.values.items():
            columns[f"{topic}/{name}"] = sampled(signals.times, values)
    measured = {name: values for name, values in columns.items() if not np.isnan(values).all()}
    return BagTable(measured, _describe_missing_columns(main, joints[main]))


def _describe_missing_columns(topic: str, signals: Signals) -> str:
    """Return why the columns of a tendon are not there, and how to name them; "" if they are."""
    joint = f"{topic}/{signals.joints[0]}" if signals.joints else topic
    efforts = [values for name, values in signals.values.items() if name.endswith("/effort")]
    if all(np.isnan(values).all() for values in efforts):
        return (
            f"effort is empty in every message of {topic}, and nothing is known without a tension; "
            "record a driver that publishes effort, or name another signal by --column "
            "proximal_tension=..."
        )
    if topic.endswith(ACTUATORS):
        return ""

    def options(effort: str, travel: str) -> str:
        return (
            f"--column proximal_{effort}={joint}/effort --column proximal_{travel}={joint}/position"
        )

    return (
        f"sensor_msgs/JointState does not tell metres and newtons from radians and newton metres; "
        f"say which {topic} has: {options('tension', 'displacement')} for m and N, or "
        f"{options('torque', 'angle')} for rad and N m (only `teleop diagnose` reads these)"
    )


def _find_distal_columns(
    main: str, joints: Mapping[str, Signals], wrenches: Mapping[str, Signals]
) -> DistalColumns | None:
    bench = [topic for topic in joints if topic.endswith(BENCH) and topic != main]
    if len(bench) == 1:
        signals, columns = joints[bench[0]], dict[str, Array]()
        for number, name in enumerate(signals.joints, start=1):
            for end, quantity in (("tension", "effort"), ("displacement", "position")):
                column = format_standard_name(LINEAR, f"distal_{end}", number)
                columns[column] = signals.values[f"{name}/{quantity}"]
        return DistalColumns(bench[0], signals.times, columns)
    if not main.endswith(ACTUATORS) and len(wrenches) == 1:  # else it may be an estimate of ours
        ((topic, signals),) = wrenches.items()
        columns = {format_standard_name(LINEAR, "distal_tension"): signals.values["force_x"]}
        return DistalColumns(topic, signals.times, columns)
    return None


def _find_main_topic(path: Path, joints: Mapping[str, Signals]) -> str:
    actuators = [topic for topic in joints if topic.endswith(ACTUATORS)]
    topics = actuators or list(joints)
    if len(topics) == 1:
        return topics[0]
    if not topics:
        raise UsageError(f"{path}: has no sensor_msgs/msg/JointState messages")
    joint = next(iter(joints[topics[0]].joints), "JOINT")
    raise UsageError(
        f"{path}: has several JointState topics ({', '.join(sorted(topics))}), none of which is "
        f"the only .../{ACTUATORS}; name the signals, as in --column "
        f"proximal_tension={topics[0]}/{joint}/effort"
    )


class _RecordedTopic:
    """The messages of one topic as numbers, in the order of the files.

    A joint is one that the first message names; what a message lacks is NaN.
    """

    def __init__(self, type_name: str) -> None:
        self.type = type_name
        self._log_ns, self._stamps_ns = array("q"), array("q")
        self._values: dict[str, array[float]] = {}

    def add(self, log_ns: int, message: Any) -> int:
        """Add a message; return the number of values that it takes."""
        is_joint = self.type == JOINT_STATE
        values = (_extract_joint_values if is_joint else _extract_wrench_values)(message)
        if not self._log_ns:
            self._values = {name: array("d") for name in values}
        self._log_ns.append(log_ns)
        self._stamps_ns.append(to_stamp_ns(message.header))
        for name, column in self._values.items():
            column.append(values.get(name, np.nan))
        return len(self._values) + 2

    def build_signals(self) -> Signals:
        """Return the signals in the order in which they were recorded."""
        log_ns, stamps_ns = (np.array(each, np.int64) for each in (self._log_ns, self._stamps_ns))
        order = np.argsort(log_ns, kind="stable")
        times = stamps_ns if (stamps_ns > 0).all() else log_ns
        values = {name: np.array(column)[order] for name, column in self._values.items()}
        return Signals(times[order], values)


def _extract_joint_values(message: Any) -> dict[str, float]:
    measured = {
        quantity: dict(zip(message.name, getattr(message, quantity).tolist(), strict=False))
        for quantity in _MOTION
    }
    return {
        f"{name}/{quantity}": measured[quantity].get(name, np.nan)
        for name in dict.fromkeys(message.name)
        for quantity in _MOTION
    }


def _extract_wrench_values(message: Any) -> dict[str, float]:
    return {
        f"{quantity}_{axis}": getattr(getattr(message.wrench, quantity), axis)
        for quantity in ("force", "torque")
        for axis in _AXES
    }


def _read_topics(path: Path) -> dict[str, _RecordedTopic]:
    """Return all topics of the two types; of a damaged or truncated file what can be read."""
    topics: dict[str, _RecordedTopic] = {}
    cells = 0
    for file in _list_files(path):
        scan, messages = Scan(file, loose=True), 0
        for block in scan.read_blocks():
            for number, start, end in block.messages:
                channel = scan.get_channel(number)
                schema = scan.schemas.get(channel.schema_id)
                if (
                    schema is None
                    or schema.name not in (JOINT_STATE, WRENCH_STAMPED)
                    or channel.message_encoding != "cdr"
                ):
                    continue
                log_ns = MESSAGE_HEAD.unpack_from(block.content, start)[2]
                try:
                    data = block.content[start + MESSAGE_HEAD.size : end]
                    message = decode(schema.name, data)
                    topic = topics.setdefault(channel.topic, _RecordedTopic(schema.name))
                    cells += topic.add(log_ns, message)
                except (CdrError, OverflowError) as error:
                    raise UsageError(
                        f"{file}: a message of {channel.topic} is damaged: {error}"
                    ) from error
                messages += 1
                if cells > read_limits.CELLS_MAX:
                    raise UsageError(
                        f"{path}: has more than {read_limits.CELLS_MAX} values of JointState and "
                        "WrenchStamped; keep fewer topics, or less time: ros2 bag convert"
                    )
        if shortfall := scan.describe_shortfall(f"{messages} messages"):
            remedy = "`mcap recover` or `ros2 bag reindex` may save the file"
            if not messages:
                raise UsageError(f"{shortfall}; {remedy}")
            print_warning(f"{shortfall}; {remedy}")
    return topics


def _list_files(path: Path) -> Iterator[Path]:
    """Yield the MCAP files of a bag."""
    if not path.is_dir():
        yield path
        return
    if not (path / METADATA).is_file():
        print_warning(
            f"{path}: has no {METADATA}, `ros2 bag reindex` makes one; all .mcap are read"
        )
        yield from sorted(path.glob("*.mcap"))
        return
    content = strict_yaml.read(path / METADATA, "metadata of a bag")
    try:
        names = [str(n) for n in content["rosbag2_bagfile_information"]["relative_file_paths"]]
    except (KeyError, TypeError) as error:
        raise UsageError(f"{path / METADATA}: is not that of a rosbag2") from error
    for name in names:
        if not name.endswith(".mcap"):
            raise UsageError(
                f"{path}: {name} is not an MCAP file; convert the bag to storage mcap without "
                "compression: ros2 bag convert"
            )
        file = path / Path(name).name
        if not file.is_file():
            raise UsageError(
                f"{path}: {METADATA} names {file.name}, which is not there; copy it too, or write "
                f"{METADATA} anew for the files that are there: ros2 bag reindex {path}"
            )
        yield file
