import dataclasses
import os
import resource
import signal
import subprocess
import sys
import textwrap
import tracemalloc

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC, Writer
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as Ros2Writer

from slave.config import SlaveConfig
from teleop.cli import commands
from teleop.config.loading import ConfigDocument
from teleop.errors import TeleopError, UsageError
from teleop.messages.messages import LAYOUT
from teleop.messages.topics import COMMAND, EVENT, STATE, TENDONS, TOPICS
from teleop.recording import reader
from teleop.recording.command import collect_files
from teleop.recording.reader import (
    open_recording,
    read_columns,
    read_messages,
    read_recorded_config,
    to_dtype,
)
from teleop.recording.scan import CONFIG_ATTACHMENT, SESSION_METADATA, RecordingError
from teleop.recording.writer import SENDERS, GapCounter, RecordConfig, RecordingWriter
from teleop.session.config import RunConfig
from tests.root import ROOT
from tests.teleop.recorded import START_NS, heard


def chunk_by_chunk(directory, chunks, compression="zstd"):
    """Record `chunks`; returns the file and its length after each of them."""
    config = RecordConfig(directory=str(directory), chunk_s=0.01, compression=compression)
    writer = RecordingWriter(config, "demo", START_NS, "session: demo\n", ["rate_hz=500", "a=b"])
    lengths = []
    for k, chunk in enumerate(chunks):
        writer.write(chunk, START_NS + (k + 1) * 10_000_000)
        lengths.append(writer.path.stat().st_size)
    writer.close()
    return writer.path, lengths


@pytest.fixture(scope="module")
def all_topics(tmp_path_factory):
    """Five messages of each topic in two chunks."""
    rng = np.random.default_rng(1)
    messages = [heard(topic, k, rng) for k in range(5) for topic in TOPICS]
    path, _ = chunk_by_chunk(tmp_path_factory.mktemp("all"), [messages[:17], messages[17:]])
    return path, messages


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_ros_2_tools_read_the_values_that_were_sent(tmp_path, compression):
    rng = np.random.default_rng(2)
    messages = [heard(topic, k, rng) for k in range(3) for topic in TOPICS]
    path, _ = chunk_by_chunk(tmp_path, [messages], compression)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        decoded = list(reader.iter_decoded_messages(log_time_order=False))
    assert len(decoded) == len(messages)
    for sent, (schema, channel, record, values) in zip(messages, decoded, strict=True):
        assert channel.topic == f"/{sent.topic.name}"
        assert schema.name == f"tendon_teleop/msg/{sent.topic.message.__name__}"
        assert (record.log_time, record.sequence) == (sent.received_ns, sent.sequence)
        assert record.publish_time == START_NS + sent.sequence * 1_000_000
        for name, value in dataclasses.asdict(sent.topic.message.unpack(sent.data)).items():
            theirs = getattr(values, name)
            np.testing.assert_array_equal(
                list(theirs) if isinstance(theirs, bytes) else theirs, value
            )


def test_columns_hold_every_field(all_topics):
    path, messages = all_topics
    for topic in TOPICS:
        schema = topic.message.schema
        assert to_dtype(schema.ros_definition) == schema.dtype
        sent = [m for m in messages if m.topic is topic]
        columns = read_columns(path, topic.name)
        np.testing.assert_array_equal(columns["log_time_ns"], [m.received_ns for m in sent])
        np.testing.assert_array_equal(columns["publish_time_ns"], columns["stamp_ns"])
        for k, one in enumerate(sent):
            for name, value in dataclasses.asdict(topic.message.unpack(one.data)).items():
                np.testing.assert_array_equal(columns[name][k], value)


def test_chosen_columns_are_packed_and_equal(all_topics):
    path, _ = all_topics
    everything = read_columns(path, "tendons")
    some = read_columns(path, "tendons", ["stamp_ns", "proximal_tension"])
    assert some.dtype.names == ("stamp_ns", "proximal_tension")
    assert some.dtype.itemsize == 8 + 16 * 8
    for name in some.dtype.names:
        np.testing.assert_array_equal(some[name], everything[name])


def test_a_recording_says_what_made_it(all_topics):
    path, messages = all_topics
    info = open_recording(path)
    assert info.complete
    assert (info.session, info.layout, info.config_text) == ("demo", LAYOUT, "session: demo\n")
    assert info.overrides == ("rate_hz=500", "a=b")
    assert info.messages == {topic.name: 5 for topic in TOPICS}
    assert (info.first_ns, info.last_ns) == (messages[0].received_ns, messages[-1].received_ns)
    assert info.seconds == pytest.approx(0.004)
    assert set(info.versions) >= {"python", "mcap", "tendon-teleop"}


widths = (8, 16, 32, 64)
scalar_types = st.sampled_from(
    ["bool", "float32", "float64", *(f"{sign}int{w}" for sign in ("", "u") for w in widths)]
)


@settings(max_examples=20)
@given(st.lists(st.tuples(scalar_types, st.integers(0, 5)), min_size=1, max_size=12), st.data())
def test_recordings_of_any_other_layout_are_read(tmp_path_factory, layout, data):
    """Written by the ROS 2 tools' own encoder, from definitions this project never had."""
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    lines = ["# an older layout", "uint8 SOME_CONSTANT=3", ""]
    message = {}
    for k, (kind, count) in enumerate(layout):
        lines.append(f"{kind}{f'[{count}]' if count else ''} field_{k}  # [N]")
        dtype = np.dtype(kind)
        if dtype.kind == "f":
            row = rng.normal(size=max(count, 1)).astype(dtype).tolist()
        elif dtype.kind == "b":
            row = (rng.random(max(count, 1)) > 0.5).tolist()
        else:
            row = rng.integers(0, np.iinfo(dtype).max, max(count, 1), dtype=dtype).tolist()
        message[f"field_{k}"] = row if count else row[0]
    path = tmp_path_factory.mktemp("old") / "old.mcap"
    with path.open("wb") as file:
        writer = Ros2Writer(file)
        schema = writer.register_msgdef("old/msg/State", "\n".join(lines))
        for k in range(3):
            writer.write_message("/state", schema, message, log_time=k, publish_time=k)
        writer.finish()
    columns = read_columns(path, "state")
    assert len(columns) == 3
    for name, value in message.items():
        np.testing.assert_array_equal(columns[name][2], value)
    with pytest.raises(RecordingError, match="no field 'distal_tension'"):
        read_columns(path, "state", ["distal_tension"])


@pytest.mark.parametrize("definition", ["string text", "float64[] many", "Head head", "what?"])
def test_fields_of_variable_size_are_refused(definition):
    with pytest.raises(ValueError, match="not a field of fixed size"):
        to_dtype(definition)


@pytest.fixture(scope="module")
def three_chunks(tmp_path_factory):
    """A small recording: its bytes, its messages, and (length, messages) after each chunk."""
    rng = np.random.default_rng(3)
    messages = [heard((COMMAND, EVENT)[k % 2], k // 2, rng) for k in range(6)]
    chunks = [messages[:2], messages[2:4], messages[4:]]
    path, lengths = chunk_by_chunk(tmp_path_factory.mktemp("three"), chunks)
    return path.read_bytes(), [m.data for m in messages], list(zip(lengths, (2, 4, 6), strict=True))


@pytest.mark.parametrize("step", [11, pytest.param(1, marks=pytest.mark.slow)])
def test_cut_off_anywhere_every_finished_chunk_is_read(tmp_path, three_chunks, step):
    content, sent, finished = three_chunks
    path = tmp_path / "cut.mcap"
    ends = {end + k for end, _ in finished for k in range(-2, 3)}
    for length in sorted({*range(8, len(content), step), *ends} & {*range(8, len(content))}):
        path.write_bytes(content[:length])
        back = [m.data for m in read_messages(path)]
        assert back == sent[: len(back)]
        assert len(back) >= max((count for end, count in finished if end <= length), default=0)
        if length % 50 == 0 or length > len(content) - 10:
            info = open_recording(path)
            assert not info.complete
            assert sum(info.messages.values()) == len(back)


every_byte = pytest.mark.parametrize("step", [11, pytest.param(1, marks=pytest.mark.slow)])


@every_byte
def test_a_damaged_byte_is_noticed_or_harmless(tmp_path, three_chunks, step):
    content, sent, _ = three_chunks
    path = tmp_path / "damaged.mcap"
    for at in range(0, len(content), step):
        path.write_bytes(content[:at] + bytes([content[at] ^ 0x01]) + content[at + 1 :])
        try:
            back = [message.data for message in read_messages(path)]
            info = open_recording(path)
            read_columns(path, "command")
        except RecordingError:
            continue
        assert back == sent[: len(back)]
        assert len(back) == len(sent) or not info.complete


@every_byte
def test_a_damaged_byte_before_a_cut_gives_no_wrong_message(tmp_path, three_chunks, step):
    """Without an end the file's own checksum is gone; each chunk still has one."""
    content, sent, finished = three_chunks
    content = content[: finished[1][0]]
    path = tmp_path / "damaged.mcap"
    for at in range(0, len(content), step):
        path.write_bytes(content[:at] + bytes([content[at] ^ 0x01]) + content[at + 1 :])
        try:
            back = [message.data for message in read_messages(path)]
        except RecordingError:
            continue
        assert set(back) <= set(sent)


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (b"", "not an MCAP recording"),
        (b"time_s,proximal_tension_N\n", "not an MCAP recording"),
        (b"\x89MCAP0\r", "not an MCAP recording"),
        (None, "cannot be read: No such file"),
    ],
)
def test_what_is_no_recording_gets_one_line(tmp_path, content, what):
    path = tmp_path / "a.mcap"
    if content is not None:
        path.write_bytes(content)
    for read in (open_recording, lambda p: list(read_messages(p)), lambda p: read_columns(p, "x")):
        with pytest.raises(UsageError, match=what) as caught:
            read(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)
    os.mkfifo(tmp_path / "pipe.mcap")
    for place in (tmp_path, tmp_path / "pipe.mcap"):
        with pytest.raises(UsageError, match="is not a file"):
            open_recording(place)


PACK = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "": bytes}


def with_chunk(path, content, claimed, compression):
    """Write a file of one chunk that claims a size."""
    records = RecordBuilder()
    Chunk(compression, PACK[compression](content), 0, 0, 0, claimed).write(records)
    path.write_bytes(MCAP0_MAGIC + records.end())
    return path


@pytest.mark.parametrize("compression", PACK)
@pytest.mark.parametrize(
    ("size", "claimed", "said"),
    [
        (1 << 22, 100, "unpacks to more than the 100 bytes that it says"),
        (50, 100, "unpacks to less than the 100 bytes that it says"),
        (50, (1 << 26) + 1, "at most 67108864 are read"),
        (50, (1 << 64) - 1, "at most 67108864 are read"),
    ],
)
def test_a_chunk_unpacks_to_no_more_than_it_says(tmp_path, compression, size, claimed, said):
    path = with_chunk(tmp_path / "a.mcap", bytes(size), claimed, compression)
    with pytest.raises(RecordingError, match=said):
        open_recording(path)
    with pytest.raises(RecordingError, match=said):
        read_columns(path, "tendons")


def test_more_of_a_topic_than_memory_has_room_for_is_refused(all_topics, monkeypatch):
    monkeypatch.setattr(reader, "ROWS_MAX", 1000)
    with pytest.raises(RecordingError, match="mcap filter"):
        read_columns(all_topics[0], "tendons")


def test_a_missing_topic_is_named_with_those_present(three_chunks, tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(three_chunks[0])
    with pytest.raises(
        RecordingError, match="no messages of topic 'tendons'; it has command, event"
    ):
        read_columns(path, "tendons")


def test_senders_without_end_take_no_memory_and_their_losses_are_kept():
    gaps = GapCounter()
    for sender in range(1, 2001):
        gaps.note("stop", sender, 1)
        gaps.note("stop", sender, 4)
        gaps.note("state", 7, 3 * sender)
    assert len(gaps.lost) <= SENDERS + 2
    assert gaps.count_by_topic() == {"stop": 4000, "state": 3998}
    assert gaps.lost["state", 7] == 3998


def test_what_the_recorder_dropped_stands_in_the_file_before_it_is_closed(tmp_path):
    rng = np.random.default_rng(4)
    config = RecordConfig(directory=str(tmp_path), chunk_s=0.01)
    with RecordingWriter(config, "demo", START_NS) as writer:
        writer.note_dropped({"state": 0, "event": 0})
        writer.write([heard(STATE, 5, rng)], START_NS + 10_000_000)
        assert open_recording(writer.path).dropped == {"state": 0}
        writer.note_dropped({"state": 3, "event": 2})
        writer.write([heard(STATE, 9, rng)], START_NS + 20_000_000)
        info = open_recording(writer.path)
        assert not info.complete
        assert info.lost == {"state": 3}
        assert info.dropped == {"state": 3, "event": 2}
    assert open_recording(writer.path).dropped == {"state": 3, "event": 2}


def test_a_long_recording_with_losses_takes_no_memory_and_its_index_is_whole(tmp_path):
    """Losses change in every chunk, as on a bad network."""
    rng = np.random.default_rng(4)
    chunk = [heard(topic, 0, rng) for topic in TOPICS]
    config = RecordConfig(directory=str(tmp_path), chunk_s=0.01, compression="none")
    chunks, before = 600, 0
    tracemalloc.start()
    with RecordingWriter(config, "demo", START_NS) as writer:
        for k in range(chunks):
            if k == 400:
                before = tracemalloc.get_traced_memory()[0]
            later = [item._replace(received_ns=START_NS + k, sequence=2 * k) for item in chunk]
            writer.write(later, START_NS + (k + 1) * 10_000_000)
        grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown / (chunks - 400) < 50  # [bytes] a chunk; its index alone has 300
    with writer.path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert len(summary.chunk_indexes) == chunks
        late = list(make_reader(file).iter_messages(starting_at=START_NS + chunks - 1))
    assert len(late) == len(TOPICS)


def test_silence_moves_the_last_messages_into_the_file(tmp_path):
    rng = np.random.default_rng(5)
    with RecordingWriter(RecordConfig(directory=str(tmp_path)), "demo", START_NS) as writer:
        writer.write([heard(STATE, 0, rng)], START_NS + 10_000_000)
        writer.write([], START_NS + 50_000_000)
        assert not list(read_messages(writer.path))
        writer.write([], START_NS + 100_000_000)
        assert len(list(read_messages(writer.path))) == 1


def test_an_earlier_recording_is_never_overwritten(tmp_path):
    paths = [chunk_by_chunk(tmp_path, [])[0]]
    before = paths[0].read_bytes()
    paths += [chunk_by_chunk(tmp_path, [])[0] for _ in range(2)]
    assert [path.name for path in paths] == [
        "demo-20231114T221320Z.mcap",
        "demo-20231114T221320Z-2.mcap",
        "demo-20231114T221320Z-3.mcap",
    ]
    assert paths[0].read_bytes() == before


def test_a_full_disk_ends_the_recording_and_keeps_what_is_there(tmp_path):
    """The limit on file size makes the kernel refuse the write half-way, as a full disk does."""
    rng = np.random.default_rng(6)
    config = RecordConfig(directory=str(tmp_path), chunk_s=0.01, compression="none")
    writer = RecordingWriter(config, "demo", START_NS)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    kept = 0

    def record():
        nonlocal kept
        with writer:
            for k in range(100):
                now_ns = START_NS + (k + 1) * 10_000_000
                writer.write([heard(TENDONS, 2 * k + j, rng) for j in range(2)], now_ns)
                kept = 2 * (k + 1)

    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(TeleopError, match="write failed") as caught:
            record()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert caught.value.exit_code == 1
    assert 0 < kept < 200
    assert len(read_columns(writer.path, "tendons")) == kept
    assert writer.messages == {"tendons": kept}
    assert writer.last_ns == open_recording(writer.path).last_ns
    assert writer.path.stat().st_size == writer.bytes_written


KILLED = textwrap.dedent(
    """
    import sys, time
    import numpy as np
    from teleop.runtime.clock import now_ns
    from teleop.link import ReceivedMessage
    from teleop.recording.writer import RecordConfig
    from teleop.recording.writer import RecordingWriter
    from teleop.messages.topics import STATE
    from tests.teleop.recorded import SENDER

    writer = RecordingWriter(RecordConfig(directory=sys.argv[1]), "killed", now_ns())
    sequence = 0
    while True:
        time.sleep(0.02)
        stamp = now_ns()
        data = STATE.message().pack(SENDER, sequence, stamp)
        writer.write([ReceivedMessage(STATE, data, stamp, SENDER, sequence, stamp)], stamp)
        sequence += 1
        print(stamp, flush=True)
    """
)


@pytest.mark.real_time
def test_a_killed_recorder_loses_at_most_a_quarter_of_a_second(tmp_path):
    recorder = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    with recorder:
        assert recorder.stdout is not None
        stamps = [int(recorder.stdout.readline()) for _ in range(31)]
        recorder.send_signal(signal.SIGKILL)
        stamps += [int(line) for line in recorder.stdout]
    (path,) = tmp_path.iterdir()
    written = read_columns(path, "state")["stamp_ns"]
    assert len(written) > 0
    np.testing.assert_array_equal(written, stamps[: len(written)])
    assert stamps[-1] - written[-1] <= 250_000_000


@pytest.mark.parametrize("insecure", [False, True])
def test_a_recording_says_how_its_session_was_protected(tmp_path, insecure):
    config = RecordConfig(directory=str(tmp_path))
    with RecordingWriter(config, "demo", START_NS, insecure=insecure) as writer:
        path = writer.path
    protection = b"protection" + len(word := b"none" if insecure else b"authenticated").to_bytes(
        4, "little"
    )
    assert protection + word in path.read_bytes()


def recorded(folder, config_text="", overrides=()):
    """Return a recording without messages."""
    config = RecordConfig(directory=str(folder))
    with RecordingWriter(config, "demo", START_NS, config_text, overrides) as writer:
        return writer.path


def test_an_arm_of_a_recording_needs_no_file_beside_it(tmp_path, capsys):
    """Neither the config nor the URDF that it names, relative to its folder."""
    for name in ("notes-arm.yaml", "notes-arm.urdf"):
        (tmp_path / name).write_bytes((ROOT / "configs" / name).read_bytes())
    document = ConfigDocument.read(tmp_path / "notes-arm.yaml")
    files = collect_files(document)
    assert sorted(files) == ["arms.0.urdf", "slave.rig.arms.0.urdf"]
    config = RecordConfig(directory=str(tmp_path / "elsewhere"))
    with RecordingWriter(config, "demo", START_NS, document.text, files=files) as writer:
        pass
    wanted = document.load(RunConfig).arms[0].load_kinematics()
    (tmp_path / "notes-arm.urdf").unlink()
    with pytest.raises(UsageError, match=r"notes-arm\.urdf: cannot be read"):
        document.load(RunConfig).arms[0].load_kinematics()
    again = ConfigDocument.read(writer.path)
    assert again.load(RunConfig).arms[0].load_kinematics() == wanted
    assert again.load(SlaveConfig, "slave").rig.arms[0].load_kinematics() == wanted
    assert collect_files(again) == files  # recorded anew
    commands.main(["config", "show", "--config", str(writer.path)])
    assert "Traceback" not in capsys.readouterr().err


def of_another_writer(folder, config=b"", overrides=""):
    """Return a recording whose head another program wrote."""
    path = folder / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata(SESSION_METADATA, {"session": "demo", "overrides": overrides})
        writer.add_attachment(START_NS, START_NS, CONFIG_ATTACHMENT, "application/yaml", config)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("written", "overrides"),
    [("", ()), ("a=1", ("a=1",)), ("a=1\nb=[2]", ("a=1", "b=[2]")), ("[]", ()), ('["a"]', ("a",))],
)
def test_overrides_of_older_recordings_are_lines(tmp_path, written, overrides):
    assert (
        read_recorded_config(of_another_writer(tmp_path, overrides=written)).overrides == overrides
    )


@pytest.mark.parametrize("written", ["[", "[1]", '["a", null]', "[" * 50_000])
def test_overrides_that_are_no_list_of_texts_are_refused(tmp_path, written):
    with pytest.raises(RecordingError, match="its overrides are not a JSON list of texts"):
        read_recorded_config(of_another_writer(tmp_path, overrides=written))


@pytest.mark.parametrize("read", [read_recorded_config, ConfigDocument.read, open_recording])
@pytest.mark.parametrize("part", ["config", "overrides"])
def test_a_config_in_a_recording_is_bounded_as_in_a_file(tmp_path, part, read):
    line = "rate_hz=500\n" if part == "overrides" else "# a comment\n"
    text = line * (3_000_000 // len(line))
    if part == "overrides":
        path = of_another_writer(tmp_path, overrides=text)
    else:
        path = of_another_writer(tmp_path, config=text.encode())
    with pytest.raises(UsageError, match=rf"its {part}: \d+ bytes, at most 100000 are read"):
        read(path)


def test_overrides_that_no_reader_would_read_are_not_recorded(tmp_path):
    with pytest.raises(UsageError, match=r"^--set: the overrides have \d+ bytes"):
        recorded(tmp_path, overrides=["a=" + "x" * 100_000])
    assert not list(tmp_path.iterdir())
