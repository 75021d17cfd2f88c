"""What recording costs: processor time a message, disk a minute, and time to read it back.

python -m studies.recording

Ten seconds of messages at 1 kHz, of one joint and of eight, for each compression. Takes 10 s.
"""

import tempfile
import time
from pathlib import Path

import numpy as np

from studies.testbed.command import parse_options
from teleop.link import ReceivedMessage
from teleop.messages.messages import Command, Hand, SlaveState, TendonState, pad_values
from teleop.messages.topics import COMMAND, HAND, STATE, TENDONS, Role
from teleop.recording.reader import RecordedMessage, open_recording, read_columns, read_messages
from teleop.recording.replay_to_link import SenderRewriter
from teleop.recording.writer import RecordConfig, RecordingWriter

SECONDS = 10
DRAIN = 20  # ticks between two looks at the link
START_NS = 1_700_000_000_000_000_000


def generate_messages(joints: int) -> list[ReceivedMessage]:
    """Return what a recorder hears of a session at 1 kHz: slow motions with sensor noise."""
    rng = np.random.default_rng(1)
    messages = []
    for k in range(1000 * SECONDS):
        time_s, stamp = k * 1e-3, START_NS + k * 1_000_000
        travel = 0.01 * np.sin(3 * time_s + np.arange(2 * joints)) + 1e-6 * rng.normal(
            size=2 * joints
        )
        tension = (
            5 + 3 * np.sin(time_s + np.arange(2 * joints)) + 0.02 * rng.normal(size=2 * joints)
        )
        x, force = pad_values(travel[:joints], 8), pad_values(tension[:joints], 8)
        tendon, pulled = pad_values(tension, 16), pad_values(travel, 16)
        distal = [pad_values(scale * tension, 16) for scale in (0.7, 0.6, 0.8, 0.002, 0.3)]
        for topic, message in (
            (COMMAND, Command(position=x, velocity=x)),
            (STATE, SlaveState(position=x, force=force, force_low=force, force_high=force)),
            (
                TENDONS,
                TendonState(
                    proximal_tension=tendon,
                    proximal_displacement=pulled,
                    commanded_displacement=pulled,
                    distal_tension=distal[0],
                    distal_tension_low=distal[1],
                    distal_tension_high=distal[2],
                    elongation=distal[3],
                    front=distal[4],
                    bench_distal_tension=pad_values(
                        tension + 0.1 * rng.normal(size=2 * joints), 16
                    ),
                    bench_distal_displacement=pulled,
                ),
            ),
            (HAND, Hand(position=x, velocity=x, force=force)),
        ):
            data = message.pack(1, k, stamp)
            messages.append(ReceivedMessage(topic, data, stamp + 300_000, 1, k, stamp))  # type: ignore[arg-type]
    return messages


def main() -> None:
    """Print one line for each compression and number of joints."""
    parse_options(__doc__)
    print(
        "joints  compression  MB/min  us/message  % of a core  open, columns [s per recorded min]"
    )
    for joints in (1, 8):
        messages = generate_messages(joints)
        for compression in ("zstd", "lz4", "none"):
            with tempfile.TemporaryDirectory() as directory:
                config = RecordConfig(directory=directory, compression=compression)
                begin = time.process_time()
                with RecordingWriter(config, "bench", START_NS) as writer:
                    for k in range(0, len(messages), 4 * DRAIN):
                        writer.write(messages[k : k + 4 * DRAIN], messages[k].received_ns)
                written = time.process_time()
                open_recording(writer.path)
                opened = time.process_time()
                read_columns(writer.path, "tendons")
                read = time.process_time()
                if compression == "zstd":
                    first: list[RecordedMessage] = list(read_messages(Path(writer.path)))
            cost, per_min = written - begin, 60 / SECONDS
            print(
                f"{joints:6}  {compression:11}  {writer.bytes_written * per_min / 1e6:6.1f}  "
                f"{cost / len(messages) * 1e6:10.1f}  {cost / SECONDS * 100:11.1f}  "
                f"{(opened - written) * per_min:6.2f} {(read - opened) * per_min:6.2f}"
            )
    readdress = SenderRewriter({Role.MASTER: 1, Role.SLAVE: 2})
    begin = time.process_time()
    for item in first:
        readdress(item)
    print(f"replay: {(time.process_time() - begin) / len(first) * 1e6:.1f} us/message to readdress")


if __name__ == "__main__":
    main()
