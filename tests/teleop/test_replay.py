import json
import signal
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.errors import PeerError
from teleop.link import Link
from teleop.messages.messages import Event
from teleop.messages.topics import COMMAND, EVENT, STATE, TOPICS, Role
from teleop.recording import replay_to_link
from teleop.recording import writer as writer_module
from teleop.recording.reader import RecordedMessage, open_recording, read_columns, read_messages
from teleop.recording.replay_to_link import Player, SenderRewriter, require_present_layout
from teleop.recording.scan import RecordingError
from teleop.recording.writer import GapCounter, RecordConfig, RecordingWriter
from teleop.runtime.clock import now_ns
from tests.teleop.link.bench import free_config, wait_until
from tests.teleop.recorded import START_NS, heard, start

NONCES = {Role.MASTER: 0xAAAA, Role.SLAVE: 0xBBBB}
HEAD = ("checksum", "sender", "sequence", "stamp_ns")
PATIENCE_S = 60.0


def recorded(item):
    return RecordedMessage(item.topic.name, item.data, item.received_ns, item.stamp_ns)


def meet(*links):
    """Wait until all see the sides; subscriptions may follow presence by a moment."""
    wait_until(lambda: all(a.is_present(b.role) for a in links for b in links[:2] if a is not b))
    time.sleep(0.2)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Two hundred messages within 40 ms, one of them missing; returns file and messages."""
    rng = np.random.default_rng(1)
    messages = [heard(t, k, rng) for k in range(40) for t in TOPICS if (t, k) != (STATE, 20)]
    config = RecordConfig(directory=str(tmp_path_factory.mktemp("replay")))
    with RecordingWriter(config, "demo", START_NS) as writer:
        writer.write(messages, START_NS)
    return writer.path, messages


def test_only_the_head_of_a_message_changes():
    for topic in TOPICS:
        sent = heard(topic, 7, np.random.default_rng(2))
        role, same_topic, data = SenderRewriter(NONCES)(recorded(sent), shift_ns=500)
        before, after = topic.message.unpack(sent.data), topic.message.unpack(data)
        assert same_topic is topic
        assert role == (topic.publisher or Role.SLAVE)
        assert (after.sender, after.sequence) == (NONCES[role], 1)
        assert after.stamp_ns == before.stamp_ns + 500
        unchanged = dict.fromkeys(HEAD, 0)
        assert replace(after, **unchanged) == replace(before, **unchanged)


def test_a_shared_topic_goes_where_its_sender_was():
    for role in Role:
        data = Event(role=role).pack(1, 1, START_NS)
        addressed = SenderRewriter(NONCES)(RecordedMessage("event", data, START_NS, START_NS))
        assert addressed.role == (Role.MASTER if role == Role.MASTER else Role.SLAVE)


@given(st.lists(st.sets(st.integers(0, 200), min_size=1, max_size=20), min_size=1, max_size=4))
def test_numbers_rise_through_restarts_and_loops_and_keep_the_gaps(processes):
    """Each set is what arrived of one process of the same role; then all of it is played again."""
    readdress, before, after = SenderRewriter(NONCES), GapCounter(), GapCounter()
    sequences = []
    for _ in range(2):
        for sender, arrived in enumerate(processes, start=1):
            for sequence in sorted(arrived):
                data = STATE.message().pack(sender, sequence, START_NS)
                head = STATE.message.schema.check(
                    readdress(RecordedMessage("state", data, START_NS, START_NS)).data
                )
                assert head.sender == NONCES[Role.SLAVE]
                sequences.append(head.sequence)
                after.note("state", head.sender, head.sequence)
    for sender, arrived in enumerate(processes, start=1):
        for sequence in sorted(arrived):
            before.note("state", sender, sequence)
    assert sequences == sorted(set(sequences))
    assert after.total == 2 * before.total


def test_what_peers_would_refuse_is_not_played(tmp_path, monkeypatch):
    config = RecordConfig(directory=str(tmp_path))
    with RecordingWriter(config, "demo", START_NS) as empty:
        pass
    with pytest.raises(RecordingError, match="has no messages"):
        require_present_layout(open_recording(empty.path))
    monkeypatch.setattr(writer_module, "LAYOUT", 0x1234)
    with RecordingWriter(config, "demo", START_NS) as other:
        other.write([heard(STATE, 0, np.random.default_rng(3))], START_NS)
    with pytest.raises(RecordingError, match="another message layout"):
        require_present_layout(open_recording(other.path))


def test_listeners_hear_the_session_again_never_early(recording):
    path, messages = recording
    config, speed = free_config(), 0.5
    with (
        Link(config, "demo-replay", Role.SLAVE) as slave,
        Link(config, "demo-replay", Role.MASTER) as master,
        Link(config, "demo-replay", Role.RECORDER) as recorder,
    ):
        listener = recorder.listen(TOPICS)
        meet(slave, master, recorder)
        began_ns = now_ns()
        player = Player(open_recording(path), speed, {Role.SLAVE: slave, Role.MASTER: master})
        assert player.play(0, lambda: False, lambda _: None)
        arrived = []

        def all_there():
            arrived.extend(listener.drain())
            return len(arrived) >= len(messages)

        wait_until(all_there)
    assert player.messages == len(messages)
    first_ns = messages[0].received_ns
    for topic in TOPICS:
        sent = [m for m in messages if m.topic is topic]
        back = [m for m in arrived if m.topic is topic]
        assert len(back) == len(sent)
        for one, again in zip(sent, back, strict=True):
            unchanged = dict.fromkeys(("checksum", "sender", "sequence"), 0)
            assert replace(topic.message.unpack(again.data), **unchanged) == replace(
                topic.message.unpack(one.data), **unchanged
            )
            assert again.received_ns - began_ns >= (one.received_ns - first_ns) / speed
            if topic is STATE:
                assert again.sequence - back[0].sequence == one.sequence - sent[0].sequence


def test_a_replay_and_a_real_loop_never_share_a_session(recording, refused):
    path, _ = recording
    config = free_config()
    ends = [f"--set=link.master={config.master}", f"--set=link.slave={config.slave}"]
    with Link(config, "demo-replay", Role.SLAVE):
        assert "has a slave already" in refused("replay", path, *ends)

    replay = start("replay", config, str(path), "--loop", "--session", "bench")
    assert "'bench'" in replay.stdout.readline()
    for role in (Role.MASTER, Role.SLAVE):
        with pytest.raises(PeerError), Link(config, "bench", role):
            pass
    assert replay.poll() is None
    replay.send_signal(signal.SIGINT)
    said, _ = replay.communicate(timeout=PATIENCE_S)
    assert replay.returncode == 0
    assert "played" in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("replay {path} --speed 0", "--speed 0"),
        ("replay nothing.mcap", "nothing.mcap: cannot be read"),
        ("record --out {path}", "name a folder"),
        ("record --out new.mcap", "'new.mcap' is named like a file; name a folder for it"),
    ],
)
def test_a_wrong_call_gets_one_line(recording, words, said, refused):
    assert said in refused(*words.format(path=recording[0]).split())


def test_the_recorder_hears_a_whole_session_and_says_so(tmp_path):
    config = free_config()
    (tmp_path / "session.yaml").write_text("session: bench\n")
    recorder = start(
        "record", config, f"--config={tmp_path / 'session.yaml'}",
        f"--out={tmp_path / 'out'}", f"--json={tmp_path / 'summary.json'}",
    )  # fmt: skip
    assert "'bench'" in recorder.stdout.readline()
    with Link(config, "bench", Role.SLAVE) as slave, Link(config, "bench", Role.MASTER) as master:
        wait_until(lambda: slave.has_listener(STATE) and master.has_listener(COMMAND))
        meet(slave, master)
        stamps = []
        for _ in range(50):
            master.publish(COMMAND, COMMAND.message())
            stamps.append(slave.publish(STATE, STATE.message(joints=3)))
            time.sleep(0.002)
        slave.publish(EVENT, Event(role=Role.SLAVE))
    recorder.send_signal(signal.SIGTERM)
    said, complaints = recorder.communicate(timeout=PATIENCE_S)
    assert (recorder.returncode, complaints) == (0, "")
    summary = json.loads((tmp_path / "summary.json").read_text())
    (path,) = (tmp_path / "out").iterdir()
    assert summary["file"] == str(path)
    assert summary["bytes"] == path.stat().st_size
    info = open_recording(path)
    assert info.complete
    assert info.session == "bench"
    assert info.config_text == "session: bench\n"
    assert summary["messages"] == info.messages == {"command": 50, "state": 50, "event": 1}
    assert summary["gaps"] == info.lost == dict.fromkeys(info.messages, 0)
    np.testing.assert_array_equal(read_columns(path, "state")["publish_time_ns"], stamps)
    assert [m.topic for m in read_messages(path)].count("event") == 1
    assert "50 messages" in said


class Wire:
    """In place of a link: notes what is sent, and when."""

    nonce = 1

    def __init__(self):
        self.sent = []  # topic, stamp, time

    def publish_raw(self, topic, data):
        self.sent.append((topic.name, topic.message.schema.check(data).stamp_ns, now_ns()))

    def check_peers(self):
        """Alone."""


def test_a_second_pass_follows_the_first_in_time_and_in_stamps(recording, monkeypatch):
    monkeypatch.setattr(replay_to_link, "_POLL_S", 0.0)  # says at each message where it is
    path, messages = recording
    wire, shown = Wire(), []
    began_ns = now_ns()
    player = Player(open_recording(path), 1.0, {Role.SLAVE: wire, Role.MASTER: wire})
    for number in range(2):
        assert player.play(number, lambda: False, shown.append)
    length_ns = messages[-1].received_ns - messages[0].received_ns
    second = wire.sent[len(messages) :]
    assert [topic for topic, _, _ in second] == [m.topic.name for m in messages]
    for message, (_, _, sent_ns) in zip(messages, second, strict=True):
        due_ns = length_ns + message.received_ns - messages[0].received_ns
        assert sent_ns - began_ns >= due_ns
    for topic in TOPICS:
        stamps = [stamp for name, stamp, _ in wire.sent if name == topic.name]
        assert stamps == sorted(set(stamps))
    assert any("pass 2" in text for text in shown)
