"""Supervise a session: collect its reports, decide when it ends."""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from teleop.errors import PeerError, TeleopError
from teleop.launch.console import Console, KeyReader, format_status
from teleop.launch.supervisor import Child, Supervisor
from teleop.link import Link, Listener, ReceivedMessage
from teleop.messages.messages import Event, Latency, LinkReport, LoopReport, decode_text
from teleop.messages.topics import LATENCY, LINK, REPORT, STATE, Role, format_role
from teleop.remote.request_listener import call_reset, call_stop
from teleop.remote.stop_over_link import SIDES, read_state, read_stop_count
from teleop.runtime.process import StopCondition
from teleop.session.state_machine import State

START_S = 240.0  # timeout for the slave; the first start compiles estimator and plant
_POLL_S = 0.1


class SessionMonitor:
    """State of a session as received: newest reports, latency, and events as text."""

    def __init__(self) -> None:
        self.reports: dict[Role, LoopReport] = {}
        self.latency: Latency | None = None
        self.links: dict[Role, LinkReport] = {}

    @property
    def running(self) -> bool:
        """Whether both loops have reported."""
        return Role.MASTER in self.reports and Role.SLAVE in self.reports

    def take(self, messages: Iterable[ReceivedMessage]) -> list[tuple[str, str]]:
        """Process events and reports; return (source, text) of the lines to print."""
        lines = []
        for item in messages:
            if item.topic is REPORT:
                report = LoopReport.unpack(item.data)
                if report.role in (Role.MASTER, Role.SLAVE):
                    self.reports[Role(report.role)] = report
            elif item.topic is LATENCY:
                self.latency = Latency.unpack(item.data)
            elif item.topic is LINK:
                link = LinkReport.unpack(item.data)
                if link.role in (Role.MASTER, Role.SLAVE):
                    self.links[Role(link.role)] = link
            else:
                event = Event.unpack(item.data)
                lines.append((format_role(event.role), decode_text(event.text)))
        return lines


class Keyboard:
    """Keys of the terminal: space requests an emergency stop, `r` resets it.

    A stop is repeated until both sides report that they have stopped, so a side that is still
    starting gets it too. A reset is repeated until it has been executed, or a newer stop requested.
    """

    def __init__(self, keys: KeyReader) -> None:
        self._keys = keys
        self._wanted = False
        self._resets: dict[Role, int] = {}  # by side, number of the stop to be reset

    def look(self, link: Link, seconds: float) -> None:
        """Wait for keys for at most `seconds` [s] and execute them; a stop has precedence."""
        pressed = self._keys.wait(seconds)
        stops = {
            side: read_stop_count(link, side)
            for side in SIDES
            if read_state(link, side) is State.STOPPED
        }
        if " " in pressed:
            self._wanted, self._resets = True, {}
        elif "r" in pressed:
            self._wanted, self._resets = False, stops
        self._wanted = self._wanted and (" " in pressed or len(stops) < len(SIDES))
        if self._wanted:
            call_stop(link, Role.LAUNCHER, "space bar of the terminal")
        self._resets = {s: n for s, n in self._resets.items() if stops.get(s) == n}
        for side, number in self._resets.items():
            call_reset(link, Role.LAUNCHER, "the terminal", side, number)


def require_free_session(link: Link) -> None:
    """Raise `PeerError` if the session has a slave or a master before ours are called."""
    for role in (Role.SLAVE, Role.MASTER):
        if link.is_present(role):
            raise PeerError(
                f"session {link.session!r} has a {role.name.lower()} already; stop that one first, "
                "or choose another session name and other endpoints"
            )


@dataclass
class SessionWatch:
    """Supervises a session: passes on what it says, and tells when it ends.

    `listener` is of events and reports, since before the slave was called; `poll` waits for
    at most the time [s] that it is given.
    """

    link: Link
    listener: Listener
    supervisor: Supervisor
    console: Console
    stop: StopCondition
    poll: Callable[[float], None]
    monitor: SessionMonitor = field(default_factory=SessionMonitor)

    def wait_for_slave(self) -> Child | None:
        """Wait for the slave to answer; return a child that ended before, if any.

        A slave that calibrates its rig first answers late and prints its progress.
        """
        self.link.subscribe_latest(STATE)
        while not self.stop() and self.link.take_latest(STATE).message is None:
            if (child := self._look()) is not None:
                return child
            if time.monotonic() > self.supervisor.children["slave"].heard_s + START_S:
                raise TeleopError(f"the slave did not start within {START_S:g} s")
            self.poll(_POLL_S)
        return None

    def run(self, duration_s: float | None, begin: Callable[[], None]) -> Child | None:
        """Supervise a session until it ends; return the child that ended it, if any.

        `duration_s` [s], None for ever, is counted from when both loops have reported, when `begin`
        is called.
        """
        patience = time.monotonic() + START_S
        end, began = math.inf, False
        while not self.stop():
            if (child := self._look()) is not None:
                return child
            if self.monitor.running and not began:
                began = True
                begin()
                end = time.monotonic() + (math.inf if duration_s is None else duration_s)
            if time.monotonic() >= end:
                self.stop.request("duration reached")
            if not self.monitor.running and time.monotonic() > patience:
                raise TeleopError(f"the loops did not start within {START_S:g} s")
            if self.console.status.live:
                self._show_status()
            self.poll(_POLL_S)
        return None

    def _look(self) -> Child | None:
        """Print what has come; return a child whose end ends the session."""
        for source, text in self.monitor.take(self.listener.drain()):
            self.console.say(source, text)
        return self.supervisor.find_failed_child()

    def _show_status(self) -> None:
        seen, record = self.monitor, self.supervisor.children.get("record")
        recorder = "" if record is None else record.status
        state = self.link.take_latest(STATE).message
        self.console.status.show(
            format_status(
                seen.reports, state, seen.latency, recorder, seen.links, self.link.insecure
            )
        )
