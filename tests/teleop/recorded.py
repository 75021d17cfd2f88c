"""Messages as a listener hears them, links and commands, for tests of recordings."""

import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from teleop.link import LinkConfig, ReceivedMessage
from teleop.messages.messages import Message
from teleop.messages.topics import Topic
from teleop.recording.writer import RecordConfig, RecordingWriter

START_NS = 1_700_000_000_000_000_000
SENDER = 0x0123_4567_89AB_CDEF


def random_message(cls: type[Message], rng: np.random.Generator) -> Message:
    """A message with every field of its own, so that a swapped or shifted field shows."""
    values: dict[str, Any] = {}
    for item in fields(cls)[5:]:
        wire = cls.schema.wires[item.name]
        dtype = np.dtype(wire.numpy)
        if dtype.kind == "f":
            row = rng.normal(size=wire.count).tolist()
        else:
            row = rng.integers(0, np.iinfo(dtype).max, wire.count, dtype=dtype).tolist()
        values[item.name] = tuple(row) if wire.count > 1 else row[0]
    return cls(**values)


def heard(
    topic: Topic[Any], sequence: int, rng: np.random.Generator, sender: int = SENDER
) -> ReceivedMessage:
    """A message sent on a 1 ms grid and received 0.3 ms later."""
    sent_ns = START_NS + sequence * 1_000_000
    data = random_message(topic.message, rng).pack(sender, sequence, sent_ns)
    return ReceivedMessage(topic, data, sent_ns + 300_000, sender, sequence, sent_ns)


def record(
    folder: Path,
    messages: Iterable[tuple[Topic[Any], Message, int] | tuple[Topic[Any], Message, int, int]],
    config: str = "",
    overrides: Sequence[str] = (),
    delay_ns: int = 0,
    **settings: Any,
) -> Path:
    """Record messages by the recorder's own writer, each of them at once.

    Each is (topic, message, time sent), received `delay_ns` later, or with a time of receipt last.
    """
    numbers: Counter[Topic[Any]] = Counter()
    how = RecordConfig(directory=str(folder), **settings)
    with RecordingWriter(how, "demo", START_NS, config, overrides) as writer:
        for topic, message, sent_ns, *received in messages:
            number, numbers[topic] = numbers[topic], numbers[topic] + 1
            data = message.pack(SENDER, number, sent_ns)
            (received_ns,) = received or (sent_ns + delay_ns,)
            item = ReceivedMessage(topic, data, received_ns, SENDER, number, sent_ns)
            writer.write([item], received_ns)
    return writer.path


RUN = """
import sys
from teleop import __main__
from teleop.runtime.process import die_with_parent
die_with_parent(int(sys.argv.pop(1)))
sys.exit(__main__.main())
"""


def start(command: str, link: LinkConfig, *arguments: str) -> "subprocess.Popen[str]":
    """Start a command as a process of its own, which ends with this one."""
    ends = [f"--set=link.master={link.master}", f"--set=link.slave={link.slave}"]
    return subprocess.Popen(
        [sys.executable, "-c", RUN, str(os.getpid()), command, *arguments, *ends],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
