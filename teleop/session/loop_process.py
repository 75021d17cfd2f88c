"""What both sides of a session do around their tick: start, count, report, and end."""

import argparse
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from enum import IntFlag
from typing import Any, ClassVar, TypeVar

from estimator.structs import StructArray
from teleop.coupling import LedgerPublisher
from teleop.errors import PeerError, TeleopError, UsageError
from teleop.link import LatestMessage, Link, MessageCounts
from teleop.link.health import DEFAULT_BOUNDS, HealthConfig, LinkHealth, update_link_window
from teleop.messages.messages import Answer, encode_text
from teleop.messages.topics import ANSWER, LEDGER, LINK, REPORT, Role
from teleop.remote.request_listener import RequestListener, Requests, SettingRequest, find_side
from teleop.remote.stop_socket import SILENT, StopSocket
from teleop.runtime.clock import Tick, TickStats, now_ns, pause_garbage_collection
from teleop.runtime.process import StopCondition, is_supervised, write_summary
from teleop.runtime.realtime import enter_loop, request_realtime
from teleop.session.config import RunConfig
from teleop.session.events import MARK, publish_event
from teleop.session.loop_meter import LoopMeter
from teleop.session.state_machine import (
    OutlineReader,
    Reason,
    SessionOutline,
    State,
    to_known_state,
    to_reason,
)
from teleop.session.summary import LoopSummary, find_fault, format_loop, format_rig

PEER_TIMEOUT_NS = 1_000_000_000  # [ns] without a message, after which a peer is not connected
# messages without a tag between two reports; fewer are of a process that just starts
UNTAGGED_MIN = 50


class LoopProcess(ABC):
    """One side of a session: its link, its counts, and why it ended.

    `stats` are of the clock that it ticks by; `memory`, shape (1,), is the state of the loop:
    `session`, and `coupling` with the energy ledger, of which `joints` ports are in use. `error` is
    what ended the session, if it was not asked to end; `ended` why it is over, from this side,
    empty while it is not.
    """

    role: ClassVar[Role]
    verdict: ClassVar[type[IntFlag]]  # of the gate

    def __init__(
        self,
        link: Link,
        stats: TickStats,
        memory: StructArray,
        joints: int,
        requests: RequestListener | None = None,
        health: HealthConfig = DEFAULT_BOUNDS,
    ) -> None:
        self.error: TeleopError | None = None
        self.ended = ""
        self._link = link
        self._outline = OutlineReader(memory["session"])
        self._stops = memory["session"]["stops"]
        self._ledger = LedgerPublisher(self.role, memory["coupling"], joints)
        self._requests = requests or RequestListener(link)
        self._meter = LoopMeter(self.role, stats)
        self._verdicts = Counter[int]()
        self._refused: dict[str, int] = {}  # by topic
        self._forged: dict[str, int] = {}  # of them
        self._health = LinkHealth(health)
        self._link_reason, self._link_holds = int(Reason.NONE), False  # for the session
        self._link_scale = 1.0  # of force and motion
        self._reports: Iterator[None] = iter(())  # those that are being published
        self._observed_ns = 0  # stamp of the newest message observed

    @abstractmethod
    def tick(self, tick: Tick) -> None:
        """Do one cycle of the loop."""

    @abstractmethod
    def close(self) -> None:
        """Leave the actuators safe and tell the peers; called however the loop ends."""

    @abstractmethod
    def _take_warnings(self) -> Iterable[str]:
        """Return what has become doubtful about this side; some may be empty."""

    @abstractmethod
    def _change_setting(self, key: str, value: str) -> str:
        """Change a setting of this side; return it as text, or raise `UsageError`."""

    def _process_settings(self, settings: Iterable[SettingRequest]) -> None:
        """Change this side's settings, or make marks, and answer the requests for them."""
        for request in settings:
            if find_side(request.key) is not self.role:
                continue
            accepted = True
            try:
                if request.key == MARK:
                    event = text = f"{MARK}: {request.value}"
                else:
                    text = self._change_setting(request.key, request.value)
                    event = f"set: {text}"
                publish_event(self._link, self.role, self._outline(), event)
            except UsageError as error:
                text, accepted = str(error), False
            answer = Answer(
                role=self.role,
                asker=request.asker,
                setting_sequence=request.sequence,
                accepted=accepted,
                text=encode_text(text),
            )
            self._link.publish(ANSWER, answer)

    def summarise(self) -> LoopSummary:
        """Return the figures of the run."""
        verdicts = {str(self.verdict(bits).name): n for bits, n in self._verdicts.items()}
        counts = self._link.count_messages()
        link = self._health.build_summary(counts)
        return self._meter.build_summary(self._outline(), counts, verdicts, link)

    def publish_end(self) -> None:
        """Publish the last report, from which a recorder sees whether it has everything."""
        self._publish_report(self._link.count_messages(), ended=True)

    def _end_session(self, error: TeleopError) -> None:
        """End the session; the first error is kept."""
        self.error = self.error or error
        self.ended = str(self.error)

    def _finish_requests(
        self, side: SessionOutline, requests: Requests, latest: LatestMessage[Any], now: int
    ) -> None:
        """Tell the others of an executed stop, and answer requests from this machine."""
        self._requests.relay(self.role, side, requests.stop_text)
        if self._requests.is_asked:
            answer_requests(
                self._link, self._requests, self.role, side, int(self._stops[0]), latest, now
            )

    def _publish_ledger(self, stamp_ns: int) -> None:
        if self._ledger.is_due(stamp_ns) and not self._link.skip_unsubscribed(LEDGER):
            self._link.publish_packet(LEDGER, self._ledger.fill())

    def _watch_link(
        self, stamp_ns: int, latest: LatestMessage[Any], echo_ns: int, hold_ns: int, peer: int = 0
    ) -> None:
        """Take the peer's newest message; now and then decide what the link allows.

        See `link_health.observe`. `peer` is the `Reason` of an engaged peer.
        """
        if latest.stamp_ns != self._observed_ns:
            self._observed_ns = latest.stamp_ns
            update_link_window(
                self._health.windows, latest.stamp_ns, latest.received_ns, echo_ns, hold_ns
            )
        if self._health.is_due(stamp_ns):
            if self._health.update(stamp_ns, latest.counts, to_reason(peer)):
                decision = self._health.decision
                self._link_reason, self._link_holds = int(decision.reason), decision.holds
                self._link_scale = decision.scale
            if self._health.figures.clock_set:
                latest.was_clock_set()

    def _report(self, stamp_ns: int, latest: LatestMessage[Any]) -> None:
        """Publish the next part of the reports, if they are due."""
        if self._meter.is_due(stamp_ns):
            self._reports = self._publish_reports(latest)
        next(self._reports, None)

    def _publish_reports(self, latest: LatestMessage[Any]) -> Iterator[None]:
        """Publish the reports and warnings, and check that no peer is there twice.

        A part in each tick: all at once took half a period, and made every such tick late.
        """
        counts = latest.counts
        self._link.publish(
            LINK, self._health.build_message(self.role, counts, latest.compute_age_ns(now_ns()))
        )
        yield
        self._publish_report(counts)
        yield
        self._publish_refusals(counts)
        try:
            self._link.check_peers()
        except PeerError as error:
            self._end_session(error)
        yield
        for text in filter(None, self._take_warnings()):
            publish_event(self._link, self.role, self._outline(), f"WARNING: {text}")
        health = self._health
        for durations in (*self._meter.unreported, health.round_trip, health.jitter):
            yield
            durations.take_span()

    def _publish_report(self, counts: MessageCounts, ended: bool = False) -> None:
        sent = self._link.list_last_sequences()
        report = self._meter.build_report(now_ns(), self._outline(), counts, sent, ended)
        self._link.publish(REPORT, report)

    def _publish_refusals(self, counts: MessageCounts) -> None:
        """Publish what was refused since the last time."""
        peers = "messages of the peer"
        forged = self._requests.count_forged() | {peers: counts.forged}
        refused = self._requests.count_refused() | {peers: counts.forged + counts.unknown}
        for name, count in refused.items():
            forged_count = forged[name] - self._forged.get(name, 0)
            new = count - self._refused.get(name, 0)
            if forged_count:
                self._link.refusals.note(f"{name} with a wrong tag", forged_count)
            if new - forged_count >= UNTAGGED_MIN:
                self._link.refusals.note(f"{name} of an unknown sender", new - forged_count)
        self._refused, self._forged = refused, forged
        for line in self._link.refusals.take():
            publish_event(self._link, self.role, self._outline(), line)


def answer_requests(
    link: Link,
    requests: RequestListener,
    role: Role,
    side: SessionOutline,
    stops: int,
    latest: LatestMessage[Any],
    now_ns: int,
) -> None:
    """Answer the executed requests from this machine for a side whose peer's newest is `latest`."""
    other, peer = Role.SLAVE if role is Role.MASTER else Role.MASTER, ""
    if latest.is_fresh(now_ns, PEER_TIMEOUT_NS):
        state = State(to_known_state(latest.packet.records["state"][0]))
        if state is not State.OFF or link.is_present(other):  # else it has said so and ended
            peer = state.name.lower()
    elif link.is_present(other):  # it hangs, or starts, and may move its motors
        peer = SILENT
    requests.answer(role, side, stops, other, peer)


Process = TypeVar("Process", bound=LoopProcess)
StartedProcess = tuple[Process, Iterable[Tick], StopCondition]


def run(process: LoopProcess, clock: Iterable[Tick], stop_for: Callable[[str], None]) -> None:
    """Tick until told to stop; the actuators are left safe however this ends."""
    try:
        with pause_garbage_collection():
            for tick in clock:
                process.tick(tick)
                if process.ended:
                    stop_for(process.ended)
    finally:
        try:
            process.close()
        finally:
            process.publish_end()


def run_session(
    role: Role,
    shared: RunConfig,
    start: Callable[[Link, RequestListener, ExitStack], StartedProcess[Process]],
) -> tuple[Process, LoopSummary]:
    """Join the session, `start` the process with its hardware, and run it to its end.

    Returns the process and its summary.
    """
    granted = request_realtime(shared.realtime)  # before the link: its threads inherit the priority
    with ExitStack() as stack:
        # a process that is refused as the second of its role must not have touched the hardware
        link = stack.enter_context(Link(shared.link, shared.session, role))
        stop_socket = stack.enter_context(StopSocket(shared.session, role.name.lower()))
        process, clock, stop = start(link, RequestListener(link, stop_socket), stack)
        for warning in filter(None, (link.warning, stop_socket.warning)):
            publish_event(link, role, SessionOutline(), warning)
        enter_loop(granted, shared.realtime)
        run(process, clock, stop.request)
        summary = process.summarise()
    return process, replace(summary, stopped=stop.reason, realtime=tuple(granted))


def report_outcome(args: argparse.Namespace, process: LoopProcess, summary: LoopSummary) -> int:
    """Write and print the summary; return the exit code, or raise what ended the session."""
    write_summary(args.json, summary.to_json())
    if not is_supervised():
        print("\n".join([*format_loop(summary), *format_rig(summary)]))
    if process.error:
        raise process.error
    if not is_supervised() and (ended := find_fault([summary])):
        raise TeleopError(ended)
    return 0
