"""Convert a recording to a rosbag2, under the names that `teleop ros` publishes."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from teleop.config.loading import ConfigDocument
from teleop.errors import UsageError
from teleop.messages.messages import MAX_JOINTS, TendonState
from teleop.messages.topics import EVENT, REPORT, SHEATH, STATE, TENDONS, TOPICS
from teleop.recording.reader import RecordedMessage, open_recording, read_messages
from teleop.recording.replay_to_link import print_doubts, require_present_layout
from teleop.ros.arms import RosArm, load_ros_arms
from teleop.ros.bag_writer import BagWriter
from teleop.ros.frames import SIDES, SessionNotes, build_diagnostics, build_sheath_frames
from teleop.ros.graph import is_name
from teleop.ros.message_types import build_header, build_joint_state, require_rosbags
from teleop.ros.output_topics import (
    EVENTS,
    LIVE,
    OUTPUTS,
    NamingContext,
    OutputTopic,
    Sample,
    build_arm_frames,
    build_tendon_names,
    build_topic_name,
)
from teleop.session.config import RunConfig

BENCH = "slave/bench/measured_js"
_TOPICS = {topic.name: topic for topic in TOPICS}
_OUTPUTS: dict[str, list[OutputTopic]] = {
    topic.name: [one for one in OUTPUTS if one.source is topic] for topic in TOPICS
}


def to_bench_measured(state: TendonState) -> Iterator[Sample]:
    """Travel [m] and tension [N] of the tendons at the tip, where a bench measures them."""
    n = min(state.tendons, len(state.bench_distal_tension))
    position, effort = state.bench_distal_displacement[:n], state.bench_distal_tension[:n]
    if n and not np.isnan((*position, *effort)).all():
        header, names = build_header(state.stamp_ns), build_tendon_names(n)
        yield Sample(BENCH, build_joint_state(header, names, position, effort=effort))


class BagConverter:
    """Converts the messages of a recording one by one.

    `session` is that of the recording, for the diagnostics, `prefix` stands before topics and
    frames; between two messages of a live topic there are at least `period_s` [s], 0 = all; `arms`
    are those of the session.
    """

    def __init__(
        self,
        bag: BagWriter,
        session: str,
        prefix: str,
        period_s: float,
        arms: tuple[RosArm, ...] = (),
    ) -> None:
        self._bag, self._session, self._prefix = bag, session, prefix
        self._naming = NamingContext(prefix, arms=arms)
        self._period_ns = round(period_s * 1e9)
        self._due_ns: dict[str, int] = {}
        self._notes = SessionNotes()

    def __call__(self, recorded: RecordedMessage) -> None:
        """Add what one recorded message becomes."""
        topic = _TOPICS.get(recorded.topic)
        if topic is None or not (_OUTPUTS[topic.name] or topic is EVENT):
            return
        if topic.live and recorded.log_time_ns < self._due_ns.get(topic.name, 0):
            return
        self._due_ns[topic.name] = recorded.log_time_ns + self._period_ns
        message, now_ns = topic.message.unpack(recorded.data), recorded.log_time_ns
        if topic in (EVENT, REPORT, SHEATH):
            self._notes.add(message, now_ns)
        if topic is REPORT and message.role in SIDES:
            status = build_diagnostics(self._session, self._notes, now_ns)
            self._add(Sample("/diagnostics", status), EVENTS, recorded)
        elif topic is SHEATH:
            frames = build_sheath_frames(self._notes.sheaths, message.stamp_ns, self._prefix)
            self._add(Sample("/tf", frames), EVENTS, recorded)
        elif topic not in (EVENT, REPORT):
            if topic is STATE:
                self._naming = replace(self._naming, joints=min(message.joints, MAX_JOINTS))
                links = build_arm_frames(message, self._naming)
                if links is not None:
                    self._add(Sample("/tf", links), EVENTS, recorded)
            self._add_live(topic.name, message, recorded)
            if topic is TENDONS:
                for sample in to_bench_measured(message):
                    self._add(sample, LIVE, recorded)

    def _add_live(self, name: str, message: Any, recorded: RecordedMessage) -> None:
        times = recorded.log_time_ns, recorded.publish_time_ns
        for output in _OUTPUTS[name]:
            if output.convert is None:
                topic = build_topic_name(output.name, self._prefix)
                self._bag.write_bytes(topic, output.type, recorded.data, output.qos, *times)
                continue
            for sample in output.convert(message, self._naming):
                self._add(sample, output.qos, recorded)

    def _add(self, sample: Sample, qos: Any, recorded: RecordedMessage) -> None:
        topic = build_topic_name(sample.name, self._prefix)
        times = recorded.log_time_ns, recorded.publish_time_ns
        self._bag.write(topic, sample.message, qos, *times)


def write_bag(path: Path, folder: Path, prefix: str, rate_hz: float | None) -> int:
    """Convert a recording to a bag in a new folder, say what it lacks and what was written.

    `prefix` is before topics and frames, such as "/lab", "" = none; of a live topic are at most
    `rate_hz` messages a second, None = all. Returns the exit code. `UsageError` if an argument is
    wrong, the recording cannot be read, or the extra `ros` is missing.
    """
    if rate_hz is not None and not 0.01 <= rate_hz <= 10_000:
        raise UsageError(f"--rate {rate_hz:g}: allowed are 0.01 to 10000 [Hz]")
    if prefix and not is_name(prefix):
        raise UsageError(f"--prefix {prefix}: must be a name such as /lab")
    require_rosbags()
    info = open_recording(path)
    require_present_layout(info)
    print_doubts(info)
    with BagWriter(folder) as bag:
        document = ConfigDocument.read(info.path)
        arms = load_ros_arms(document, document.load(RunConfig).arms)
        period_s = 0.0 if rate_hz is None else 1.0 / rate_hz
        converter = BagConverter(bag, info.session, prefix, period_s, arms)
        for recorded in read_messages(info.path):
            converter(recorded)
    total = sum(bag.counts.values())
    print(f"wrote {folder}: {total} messages on {len(bag.counts)} topics, {info.seconds:.1f} s")
    return 0
