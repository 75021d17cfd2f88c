"""Publishes a session to ROS: the newest messages of the link, at the rate of the config."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from teleop.link import LatestMessage, Link
from teleop.messages.messages import MAX_JOINTS
from teleop.messages.topics import EVENT, REPORT, SHEATH, STATE, Topic
from teleop.ros.arms import RosArm
from teleop.ros.command_topics import CommandTopics
from teleop.ros.config import RosConfig
from teleop.ros.frames import SessionNotes, build_diagnostics, build_sheath_frames
from teleop.ros.message_types import encode
from teleop.ros.node import RosNode, RosPublisher
from teleop.ros.output_topics import (
    EVENTS,
    OUTPUTS,
    NamingContext,
    OutputTopic,
    build_arm_frames,
    build_topic_name,
)
from teleop.runtime.clock import Grid

SLOW_HZ = 10.0  # [Hz] of states and frames
REPORTS_HZ = 2.0  # [Hz] of diagnostics
_BY_NAME = {output.name: output for output in OUTPUTS}
OF_ARMS = {output.name for output in OUTPUTS if output.is_of_arms}
_DIAGNOSTICS, _FRAMES = _BY_NAME["/diagnostics"], _BY_NAME["/tf"]


class Publishers:
    """The topics of a session in the ROS graph.

    `link` is that of the session, as a listener; `config` says which topics, and how often; `say`
    prints a line; `arms` are those of the session.
    """

    def __init__(
        self,
        link: Link,
        node: RosNode,
        config: RosConfig,
        say: Callable[[str], None] = print,
        arms: tuple[RosArm, ...] = (),
    ) -> None:
        self._link, self._node, self._config, self._say = link, node, config, say
        outputs = [_BY_NAME[name] for name in config.topics if arms or name not in OF_ARMS]
        self._topics: dict[str, RosPublisher] = {}
        for output in outputs:
            self._build_topic(output.name, output)
        self._live = _group_by_source(one for one in outputs if one.qos is not EVENTS)
        self._slow = _group_by_source(one for one in outputs if one.qos is EVENTS and one.convert)
        # the state first: it tells how many joints there are
        self._sources = tuple(dict.fromkeys((STATE, *self._live, *self._slow)))
        for source in self._sources:
            link.subscribe_latest(source)
        self._listener = link.listen((REPORT, EVENT, SHEATH))
        self._notes = SessionNotes()
        self._commands, self._refused = CommandTopics(config.prefix), ""
        self._slow_ns = self._reports_ns = 0
        self._naming = NamingContext(config.prefix, arms=arms)
        node.watch(self._commands.note)

    @property
    def sent(self) -> dict[str, int]:
        """Number of published messages by topic."""
        return {name: publisher.sent for name, publisher in self._topics.items()}

    def run(self, stop: Callable[[], bool]) -> None:
        """Publish until told to stop."""
        for tick in Grid(self._config.rate_hz, stop):
            self.step(tick.stamp_ns)

    def step(self, stamp_ns: int) -> None:
        """Publish what is new, or due, at a stamp [ns]."""
        slow = stamp_ns >= self._slow_ns
        if slow:
            self._slow_ns = stamp_ns + round(1e9 / SLOW_HZ)
            for publisher in self._topics.values():
                publisher.look()
        for source in self._sources:
            latest = self._link.take_latest(source)
            if source is STATE and latest.is_there:
                joints = min(int(latest.packet.record.joints), MAX_JOINTS)
                if joints != self._naming.joints:
                    self._naming = replace(self._naming, joints=joints)
            if latest.new:
                self._publish(self._live.get(source, ()), latest)
                if source is STATE and _FRAMES.name in self._topics:
                    frames = build_arm_frames(latest.packet.record, self._naming)
                    if frames is not None:
                        self._put(_FRAMES.name, _FRAMES, frames)
            role = source.publisher
            if slow and latest.is_there and role is not None and self._link.is_present(role):
                self._publish(self._slow.get(source, ()), latest)
        if slow:
            for item in self._listener.drain():
                self._notes.add(item.topic.message.unpack(item.data), item.received_ns)
            refused = self._commands.describe_refused()
            if refused and refused != self._refused:
                self._say(refused)
            self._refused = refused
            if self._notes.sheaths and _FRAMES.name in self._topics:
                frames = build_sheath_frames(self._notes.sheaths, stamp_ns, self._config.prefix)
                self._put(_FRAMES.name, _FRAMES, frames)
        if stamp_ns >= self._reports_ns and _DIAGNOSTICS.name in self._topics:
            self._reports_ns = stamp_ns + round(1e9 / REPORTS_HZ)
            status = build_diagnostics(self._link.session, self._notes, stamp_ns, self._refused)
            self._put(_DIAGNOSTICS.name, _DIAGNOSTICS, status)

    def _publish(self, outputs: Iterable[OutputTopic], latest: "LatestMessage[Any]") -> None:
        for output in outputs:
            if output.convert is not None:
                for sample in output.convert(latest.message, self._naming):
                    self._put(sample.name, output, sample.message)
            elif self._topics[output.name].wanted:
                self._topics[output.name].put(latest.packet.data.tobytes())

    def _put(self, name: str, output: OutputTopic, message: Any) -> None:
        publisher = self._build_topic(name, output)
        if publisher.wanted:
            publisher.put(encode(message))

    def _build_topic(self, name: str, output: OutputTopic) -> RosPublisher:
        """Return the publisher of a topic; further joints have theirs when they are known."""
        publisher = self._topics.get(name)
        if publisher is None:
            topic = build_topic_name(name, self._config.prefix)
            publisher = self._topics[name] = self._node.advertise(topic, output.type, output.qos)
        return publisher


def _group_by_source(outputs: Iterable[OutputTopic]) -> dict[Topic[Any], list[OutputTopic]]:
    groups: dict[Topic[Any], list[OutputTopic]] = {}
    for output in outputs:
        groups.setdefault(output.source, []).append(output)
    return groups
