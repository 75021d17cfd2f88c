"""Convert a recording to a rosbag2, under the names that `teleop ros` publishes."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from teleop.messages.messages import MAX_JOINTS, Event, LoopReport, Sheath, TendonState
from teleop.messages.topics import EVENT, REPORT, SHEATH, STATE, TENDONS, TOPICS, Role
from teleop.recording.reader import RecordedMessage, RecordingInfo, read_messages
from teleop.ros.bag_writer import BagWriter
from teleop.ros.frames import build_sheath_frames
from teleop.ros.outputs import (
    EVENTS,
    LIVE,
    OUTPUTS,
    NamingContext,
    OutputTopic,
    Sample,
    build_tendon_names,
    build_topic_name,
)
from teleop.ros.reports import SIDES, build_diagnostics
from teleop.ros.standard import Header, JointState, Time

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
        header = Header(Time.of(state.stamp_ns))
        yield Sample(BENCH, JointState(header, build_tendon_names(n), position, effort=effort))


class BagConverter:
    """Converts the messages of a recording one by one.

    Parameters
    ----------
    bag : BagWriter
        The bag, open.
    session : str
        Of the recording, for the diagnostics.
    prefix : str
        Before topics and frames.
    period_s : float
        [s] least time between two messages of a live topic; 0 = all.
    """

    def __init__(self, bag: BagWriter, session: str, prefix: str, period_s: float) -> None:
        self._bag, self._session, self._prefix = bag, session, prefix
        self._naming = NamingContext(prefix)
        self._period_ns = round(period_s * 1e9)
        self._due_ns: dict[str, int] = {}
        self._reports: dict[Role, tuple[LoopReport, int]] = {}
        self._events: dict[Role, Event] = {}
        self._sheaths: dict[int, Sheath] = {}

    def __call__(self, recorded: RecordedMessage) -> None:
        """Add what one recorded message becomes."""
        topic = _TOPICS.get(recorded.topic)
        if topic is None or not (_OUTPUTS[topic.name] or topic is EVENT):
            return
        if topic.live and recorded.log_time_ns < self._due_ns.get(topic.name, 0):
            return
        self._due_ns[topic.name] = recorded.log_time_ns + self._period_ns
        message = topic.message.unpack(recorded.data)
        if topic is EVENT:
            if message.role in SIDES:
                self._events[Role(message.role)] = message
        elif topic is REPORT:
            self._add_report(message, recorded)
        elif topic is SHEATH:
            self._sheaths[message.tendon] = message
            frames = build_sheath_frames(self._sheaths, message.stamp_ns, self._prefix)
            self._add(Sample("/tf", frames), EVENTS, recorded)
        else:
            if topic is STATE:
                self._naming = NamingContext(self._prefix, min(message.joints, MAX_JOINTS))
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

    def _add_report(self, report: LoopReport, recorded: RecordedMessage) -> None:
        if report.role in SIDES:
            now = recorded.log_time_ns
            self._reports[Role(report.role)] = report, now
            status = build_diagnostics(self._session, self._reports, self._events, now)
            self._add(Sample("/diagnostics", status), EVENTS, recorded)

    def _add(self, sample: Sample, qos: Any, recorded: RecordedMessage) -> None:
        topic = build_topic_name(sample.name, self._prefix)
        times = recorded.log_time_ns, recorded.publish_time_ns
        self._bag.write(topic, sample.message, qos, *times)


def convert_recording(info: RecordingInfo, bag: BagWriter, prefix: str, period_s: float) -> None:
    """Add all messages of a recording of the present layout to a bag."""
    converter = BagConverter(bag, info.session, prefix, period_s)
    for recorded in read_messages(info.path):
        converter(recorded)
