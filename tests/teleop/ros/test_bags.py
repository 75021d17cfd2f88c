"""Bags: ours as `rosbags` reads them, and those of others as measured data."""

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from teleop.cli import commands
from teleop.config.loading import ConfigDocument
from teleop.data import read_limits
from teleop.data.file_formats import read_columns
from teleop.data.measured_table import Columns, read_table, read_tables
from teleop.errors import UsageError
from teleop.link import ReceivedMessage
from teleop.messages.messages import (
    Command,
    Event,
    Hand,
    LoopReport,
    Sheath,
    SlaveState,
    TendonState,
    pad_values,
)
from teleop.messages.topics import COMMAND, EVENT, HAND, REPORT, SHEATH, STATE, TENDONS, Role
from teleop.recording.command import collect_files
from teleop.recording.writer import RecordConfig, RecordingWriter
from teleop.ros.message_types import (
    VECTOR3,
    WRENCH,
    WRENCH_STAMPED,
    build_header,
    build_joint_state,
    build_message,
    encode,
    load_typestore,
)
from tests.root import ROOT
from tests.teleop.recorded import START_NS, record

MS = 1_000_000
NAN = float("nan")


def tension(k):
    return 5.0 + 4.0 * np.sin(k / 20)


def session(k):
    """All topics of millisecond `k`."""
    bench = pad_values((tension(k) / 2, NAN), 16)
    tendons = TendonState(
        tendons=2,
        time_s=k * 1e-3,
        proximal_tension=pad_values((tension(k), 2.0), 16),
        proximal_displacement=pad_values((k * 1e-6, NAN), 16),
        bench_distal_tension=bench,
        bench_distal_displacement=(NAN,) * 16,
    )
    yield TENDONS, tendons
    yield STATE, SlaveState(state=2, joints=1, force=pad_values((k * 1e-3,), 8))
    yield COMMAND, Command(position=pad_values((k * 1e-3,), 8))
    yield HAND, Hand(joints=1, position=pad_values((k * 1e-4,), 8))
    if k % 100 == 0:
        yield REPORT, LoopReport(role=Role.SLAVE, state=2)
        yield EVENT, Event(role=Role.SLAVE)
        yield SHEATH, Sheath(sections=1, section_length=(1.0,) * 16, section_radius=(0.0,) * 16)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    messages = ((*pair, START_NS + k * MS) for k in range(300) for pair in session(k))
    return record(tmp_path_factory.mktemp("bags"), messages, delay_ns=5)


@pytest.fixture(scope="module")
def bag(recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "demo"
    assert commands.main(["recordings", "to-ros2", str(recording), "--out", str(path)]) == 0
    return path


def test_a_bag_of_an_arm_has_its_links_and_the_pose_of_its_tip(tmp_path):
    """Of a recording alone, which brings the description of the arm."""
    document = ConfigDocument.read(ROOT / "configs" / "notes-arm.yaml")
    config, files = RecordConfig(directory=str(tmp_path)), collect_files(document)
    with RecordingWriter(config, "arm", START_NS, document.text, files=files) as writer:
        data = SlaveState(joints=4).pack(7, 1, START_NS)
        writer.write([ReceivedMessage(STATE, data, START_NS, 7, 1, START_NS)], START_NS)
    bag = tmp_path / "bag"
    assert commands.main(["recordings", "to-ros2", str(writer.path), "--out", str(bag)]) == 0
    with AnyReader([bag], default_typestore=load_typestore()) as reader:
        heard = {c.topic: reader.deserialize(data, c.msgtype) for c, _, data in reader.messages()}
    assert heard["/slave/measured_js"].name == ["shoulder", "elbow", "wrist", "gripper"]
    assert heard["/slave/measured_cp"].header.frame_id == "base"
    assert len(heard["/tf"].transforms) == 4


def test_a_reader_of_others_reads_our_bag(bag):
    with AnyReader([bag], default_typestore=load_typestore()) as reader:
        assert reader.message_count == 300 * (3 + 4 + 2 + 2) + 3 * 2 + 300 * 1
        types = {c.topic: c.msgtype for c in reader.connections}
        assert types["/slave/measured_cf"] == "geometry_msgs/msg/WrenchStamped"
        assert types["/slave/state"] == "tendon_teleop/msg/SlaveState"
        for connection in reader.connections:
            (qos,) = connection.ext.offered_qos_profiles
            assert qos.depth in (1, 10)
            assert connection.digest.startswith("RIHS01_")
        (setpoint,) = [c for c in reader.connections if c.topic == "/slave/setpoint_js"]
        lengths = {
            len(reader.deserialize(data, setpoint.msgtype).position)
            for _, _, data in reader.messages(connections=[setpoint])
        }
        assert lengths == {1}
        wanted = [c for c in reader.connections if c.topic == "/slave/actuators/measured_js"]
        for k, (connection, log_ns, data) in enumerate(reader.messages(connections=wanted)):
            message = reader.deserialize(data, connection.msgtype)
            assert message.effort.tolist() == [tension(k), 2.0]
            assert message.header.stamp.nanosec == (START_NS + k * MS) % 10**9
            assert log_ns == START_NS + k * MS + 5


def test_the_metadata_are_those_of_the_messages(bag, recording, tmp_path):
    about = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert about["version"] == 9
    assert about["duration"]["nanoseconds"] == 299 * MS
    fewer = tmp_path / "fewer"
    words = ["recordings", "to-ros2", str(recording), "--out", str(fewer), "--rate", "100"]
    assert commands.main([*words, "--prefix", "/lab"]) == 0
    assert commands.main([*words, "--prefix", "lab"]) == 2
    about = yaml.safe_load((fewer / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    counts = {
        t["topic_metadata"]["name"]: t["message_count"] for t in about["topics_with_message_count"]
    }
    assert counts["/lab/slave/measured_js"] == 30
    assert counts["/tf"] == 3


def test_our_bag_is_measured_data_like_the_recording(bag, recording):
    first, second = Columns(), Columns.from_tendon(2)
    ours, theirs = (read_tables(path, (first, second)) for path in (bag, recording))
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one.time, other.time, atol=1e-9)
        np.testing.assert_array_equal(one.proximal_tension, other.proximal_tension)
    np.testing.assert_array_equal(ours[0].proximal_displacement, theirs[0].proximal_displacement)
    np.testing.assert_allclose(ours[0].distal_tension, theirs[0].distal_tension)
    assert ours[1].proximal_displacement is None
    file = next(bag.glob("*.mcap"))
    np.testing.assert_array_equal(read_table(file).proximal_tension, ours[0].proximal_tension)


class Foreign:
    """A bag written by `rosbags`."""

    def __init__(self, path, plugin=StoragePlugin.MCAP):
        self._writer = Writer(path, version=9, storage_plugin=plugin)
        self._connections = {}

    def __enter__(self):
        self._writer.open()
        return self

    def __exit__(self, *_):
        self._writer.close()

    def write(self, topic, message, at_s):
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, message.__msgtype__, typestore=load_typestore()
            )
        stamp_ns = START_NS + round(at_s * 1e9)
        self._writer.write(self._connections[topic], stamp_ns, encode(message))


def header(at_s):
    return build_header(START_NS + round(at_s * 1e9))


def joint_state(at_s, *efforts, names=("cable", "other")):
    position = (at_s,) * len(efforts)
    return build_joint_state(header(at_s), names[: len(efforts)], position, effort=efforts)


def motion(at_s, position):
    return build_joint_state(header(at_s), ("cable",), (position,))


def wrench(at_s, x):
    force = build_message(VECTOR3, x=x, z=2 * x)
    return build_message(
        WRENCH_STAMPED, header=header(at_s), wrench=build_message(WRENCH, force=force)
    )


def named(joint, topic="/motor/joint_states", **others):
    signals = {"proximal_tension": "effort", "proximal_displacement": "position"}
    return Columns(**{name: f"{topic}/{joint}/{what}" for name, what in signals.items()} | others)


def test_a_foreign_bag_is_measured_data_with_the_force_at_its_times(tmp_path):
    with Foreign(tmp_path / "lab") as bag:
        for k in range(100):
            bag.write("/motor/joint_states", joint_state(k * 0.01, 10.0 + k, 1.0), k * 0.01)
        for k in range(40):  # later, slower and between the rows
            at_s = 0.105 + 0.02 * k
            bag.write("/sensor/wrench", wrench(at_s, at_s), at_s)
    table = read_table(tmp_path / "lab", named("cable"))
    assert len(table.time) == 78
    np.testing.assert_allclose(table.time, np.arange(78) * 0.01, atol=1e-9)
    assert table.proximal_tension[0] == 21.0  # the first row after the first force
    np.testing.assert_allclose(table.distal_tension, 0.11 + table.time, atol=1e-9)
    axis = read_table(tmp_path / "lab", named("cable", distal_tension="/sensor/wrench/force_z"))
    np.testing.assert_allclose(axis.distal_tension, 2 * (0.11 + axis.time), atol=1e-9)
    other = read_table(tmp_path / "lab", named("other"))
    assert (other.proximal_tension == 1.0).all()


def test_the_namespace_whose_signals_are_named_is_read_and_no_other(tmp_path):
    with Foreign(tmp_path / "lab") as bag:
        for k in range(50):
            for name, tension in (("left", 10.0 + k), ("right", 5.0)):
                topic = f"/{name}/actuators/measured_js"
                bag.write(topic, joint_state(k * 0.01, tension, 2.0), k * 0.01)
    with pytest.raises(UsageError, match="several JointState topics") as error:
        read_table(tmp_path / "lab")
    option, _, column = str(error.value).partition("--column ")[2].partition("=")
    table = read_table(tmp_path / "lab", Columns(**{option: column}))
    assert table.proximal_tension[-1] in (59.0, 5.0)
    assert table.proximal_displacement is None  # that of a joint which nobody named
    right = read_table(tmp_path / "lab", named("other", "/right/actuators/measured_js"))
    assert (right.proximal_tension == 2.0).all()


def test_an_estimate_is_never_taken_for_a_measurement(tmp_path):
    with Foreign(tmp_path / "ours") as bag:
        for k in range(5):
            bag.write("/slave/actuators/measured_js", joint_state(k * 0.1, 5.0), k * 0.1)
            bag.write("/slave/measured_cf", wrench(k * 0.1, 2.0), k * 0.1)
    assert read_table(tmp_path / "ours").distal_tension is None


@pytest.mark.parametrize(
    ("topics", "plugin", "words"),
    [
        (("/a/joint_states", "/b/joint_states"), StoragePlugin.MCAP, "several JointState topics"),
        (("/wrench",), StoragePlugin.MCAP, "no sensor_msgs/msg/JointState"),
        (("/a/joint_states",), StoragePlugin.SQLITE3, "ros2 bag convert"),
        (("/no_effort",), StoragePlugin.MCAP, "effort is empty in every message of /no_effort"),
    ],
)
def test_a_bag_without_clear_data_is_one_line(tmp_path, topics, plugin, words):
    with Foreign(tmp_path / "lab", plugin) as bag:
        for topic in topics:
            make = {"/wrench": wrench, "/no_effort": motion}.get(topic, joint_state)
            for k in range(3):
                bag.write(topic, make(k * 0.1, 1.0), k * 0.1)
    with pytest.raises(UsageError, match=words) as error:
        read_table(tmp_path / "lab")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("bound", "value", "words"),
    [
        ("CELLS_MAX", 2000, "156 columns have more than 12 rows, at most 2000 values"),
        ("COLUMNS_MAX", 155, "156 columns, at most 155"),
    ],
)
def test_a_table_that_is_too_large_is_refused_before_it_is_made(
    tmp_path, monkeypatch, bound, value, words
):
    names = tuple(f"joint_{k}" for k in range(50))
    with Foreign(tmp_path / "lab") as bag:
        for k in range(60):
            bag.write("/arm/actuators/measured_js", joint_state(k * 0.01, 5.0), k * 0.01)
        for k in range(3):  # 456 values, and 9000 at the rows
            others = joint_state(k * 0.3, *(1.0,) * 50, names=names)
            bag.write("/arm/joint_states", others, k * 0.3)
    path = tmp_path / "lab"
    assert len(read_columns(path).columns) == 105  # without velocities, which no message has
    monkeypatch.setattr(read_limits, bound, value)
    monkeypatch.setattr(np, "interp", lambda *_: pytest.fail("a column was made"))
    with pytest.raises(UsageError, match=words):
        read_table(path)


def test_a_damaged_bag_is_one_line(bag, tmp_path):
    data = next(bag.glob("*.mcap")).read_bytes()
    path = tmp_path / "noise.mcap"
    path.write_bytes(data[:900] + b"x" * 90)
    with pytest.raises(UsageError, match=r"0 messages could be read; `mcap recover`") as error:
        read_table(path)
    assert "\n" not in str(error.value)
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("a: 1")
    with pytest.raises(UsageError, match="not that of a rosbag2"):
        read_table(tmp_path / "bag")


@pytest.fixture
def pull(tmp_path):
    """Return a bag of one joint in two halves, in a chunk each as a recorder writes them."""
    with Foreign(tmp_path / "pull") as bag:
        for k in range(100):
            bag.write("/motor/joint_states", joint_state(k * 0.01, 10.0 + k), k * 0.01)
    return tmp_path / "pull"


MODEL = ["--set", "slave.tendons=[{effective_friction: 0.5}]"]


def test_a_joint_state_is_not_taken_for_metres_and_newtons_unasked(pull, refused):
    said = refused("estimate", pull, *MODEL)
    for end, words in {"m and N": ("tension", "displacement"), "rad": ("torque", "angle")}.items():
        assert end in said
        for word in words:
            assert f"--column proximal_{word}=/motor/joint_states/cable/" in said
    signal = "/motor/joint_states/cable"
    words = [f"--column=proximal_tension={signal}/effort"]
    words += [f"--column=proximal_displacement={signal}/position"]
    assert commands.main(["estimate", str(pull), *words, *MODEL]) == 0


def rewritten(bag, path, **how):
    """Write the messages of a bag as one file, chunked as `how` says."""
    with next(bag.glob("*.mcap")).open("rb") as source, path.open("wb") as file:
        reader, writer, channels = make_reader(source), McapWriter(file, **how), {}
        writer.start("ros2")
        for schema, channel, message in reader.iter_messages():
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                encoding = channel.message_encoding
                channels[channel.id] = writer.register_channel(channel.topic, encoding, number)
            times = message.log_time, message.data, message.publish_time
            writer.add_message(channels[channel.id], *times)
        writer.finish()
    return path


def test_of_a_truncated_bag_whole_chunks_are_read(bag, tmp_path, capsys):
    path = rewritten(bag, tmp_path / "cut.mcap", chunk_size=5000)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    table = read_table(path)
    assert 10 < len(table.time) < 300
    np.testing.assert_array_equal(table.proximal_tension, tension(np.arange(len(table.time))))
    assert "is truncated" in capsys.readouterr().err


def test_a_bag_without_metadata_is_read_with_a_remedy(pull, capsys):
    (pull / "metadata.yaml").unlink()
    table = read_table(pull, named("cable"))
    np.testing.assert_array_equal(table.proximal_tension, 10.0 + np.arange(100))
    assert "`ros2 bag reindex` makes one" in capsys.readouterr().err


@pytest.mark.parametrize("change", ["renamed", "half copied"])
def test_a_file_of_a_bag_that_is_missing_is_named(pull, change, refused):
    about = pull / "metadata.yaml"
    if change == "renamed":
        (pull / "pull.mcap").rename(pull / "copy.mcap")
    else:
        about.write_text(about.read_text().replace("- pull.mcap", "- pull.mcap\n  - pull_1.mcap"))
    said = refused("estimate", pull, *MODEL)
    assert ("pull.mcap" if change == "renamed" else "pull_1.mcap") in said
    assert "ros2 bag reindex" in said
