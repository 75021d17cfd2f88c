"""Recordings of random sessions by the recorder's own writer, and what their messages say."""

import numpy as np

from teleop.messages.messages import Command, Event, Hand, SlaveState, encode_text
from teleop.messages.topics import COMMAND, EVENT, HAND, STATE, TOPICS, Role
from teleop.recording.reader import read_messages
from teleop.session.state_machine import Reason, State
from tests.teleop import recorded
from tests.teleop.recorded import START_NS

MS = 1_000_000
CLOCK_NS = 7_000_000_000  # of the master, beside the slave's and the recorder's
_TOPICS = {topic.name: topic for topic in TOPICS}


def record(folder, messages):
    """Record (topic, message, time of receipt, stamp), one chunk each 10 ms."""
    sent = ((topic, message, stamp, received) for topic, message, received, stamp in messages)
    return recorded.record(folder, sent, chunk_s=0.01)


def session_messages(joints, states, seed=0, events=None):
    """Random messages, about a state, a command and a hand each millisecond, some missing.

    `states` are the slave's, one a millisecond; `events` texts before the state of that number.
    """
    rng = np.random.default_rng(seed)
    messages = []

    def draw(cls, *names, **values):
        arrays = {name: tuple(rng.normal(size=8).tolist()) for name in names}
        return cls(**arrays, **values)

    for k, state in enumerate(states):
        now, slave_ns = START_NS + k * MS, START_NS + k * MS + int(rng.integers(0, MS // 10))
        for text in [(events or {}).get(k)] if events is not None else []:
            if text is not None:
                event = Event(role=Role.MASTER, state=2, reason=0, text=encode_text(text))
                messages.append((EVENT, event, now + 1, now + CLOCK_NS))
        if k > 5 and rng.random() < 0.9:
            command = draw(Command, "position", "velocity", state=int(rng.integers(7)), reason=5)
            messages.append((COMMAND, command, now + 100, now + CLOCK_NS))
        if rng.random() < 0.5:
            hand = draw(Hand, "position", "velocity", "force", joints=joints)
            messages.append((HAND, hand, now + 200, now + CLOCK_NS))
        if k == 0 or rng.random() < 0.95:
            fields = ("position", "force", "force_low", "force_high")
            flags = tuple(rng.integers(0, 32, 8).tolist())
            row = draw(
                SlaveState, *fields, state=state, reason=20 * (k % 2), joints=joints, status=flags,
                sample_age_ns=k,
            )  # fmt: skip
            messages.append((STATE, row, now + int(rng.integers(300, 900)), slave_ns))
    return messages


def expect_rows(path):
    """What a table of the recording must say, message by message."""
    rows = []
    newest = {}
    texts = []
    for item in read_messages(path):
        message = _TOPICS[item.topic].message.unpack(item.data)
        if item.topic != "state":
            newest[item.topic] = message, item.log_time_ns
            if item.topic == "event":
                text = bytes(message.text).rstrip(b"\0").decode()
                texts.append((item.log_time_ns, f"{Role(message.role).name.lower()}: {text}"))
            continue
        row = {
            "stamp_ns": message.stamp_ns,
            "log_ns": item.log_time_ns,
            "events": texts,
            "slave_state": State(message.state).name.lower(),
            "slave_reason": Reason(message.reason).name.lower(),
            "sample_age_s": message.sample_age_ns / 1e9,
            "master_state": None,
            "master_reason": None,
        }
        texts = []
        for name in ("command", "hand"):
            _, log_ns = newest.get(name, (None, None))
            row[f"{name}_age_s"] = np.nan if log_ns is None else (item.log_time_ns - log_ns) / 1e9
        if "command" in newest:
            row["master_state"] = State(newest["command"][0].state).name.lower()
            row["master_reason"] = Reason(newest["command"][0].reason).name.lower()
        for j in range(message.joints):
            for name, unit in (
                ("position", "_m"), ("force", "_N"), ("force_low", "_N"), ("force_high", "_N"),
                ("status", ""),
            ):  # fmt: skip
                row[f"{name}_{j}{unit}"] = getattr(message, name)[j]
            for topic, name, unit in (
                ("command", "position", "_m"), ("command", "velocity", "_m_per_s"),
                ("hand", "position", "_m"), ("hand", "velocity", "_m_per_s"),
                ("hand", "force", "_N"),
            ):  # fmt: skip
                value = getattr(newest[topic][0], name)[j] if topic in newest else np.nan
                row[f"{topic}_{name}_{j}{unit}"] = value
        rows.append(row)
    for row in rows:
        row["time_s"] = (row["stamp_ns"] - rows[0]["stamp_ns"]) / 1e9
        row["time_unix_ns"] = row["stamp_ns"]
        row["event"] = "; ".join(text for _, text in row["events"])
    return rows
