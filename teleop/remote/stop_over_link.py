"""Stop, reset and watch over the network link."""

import select
import sys
import time
from collections.abc import Callable
from typing import Any

from teleop.errors import TeleopError
from teleop.link import Link
from teleop.messages.topics import COMMAND, STATE, Role, Topic
from teleop.remote.request_listener import (
    BEAT_S,
    CALL,
    LEAVE,
    RESET,
    SILENCE_S,
    WATCH,
    call_reset,
    call_stop,
)
from teleop.remote.stop_socket import StopSocket
from teleop.runtime.process import StopCondition
from teleop.session.config import RunConfig
from teleop.session.state_machine import Reason, State

ANSWERS_TIMEOUT_S = 3.0  # timeout for the answers of all sides
DISCOVERY_MIN_S = 0.4  # time for a second side to appear, after the first
REPEAT_S = 0.02  # between two messages: the first may be lost while the link connects
SIDES: dict[Role, Topic[Any]] = {Role.MASTER: COMMAND, Role.SLAVE: STATE}


def request_over_link(config: RunConfig, is_reset: bool, reason: str) -> dict[str, str]:
    """Send the request to every side that can be reached; return the state of each by its name."""
    stop = StopCondition()
    # an emergency stop does not wait for the detection of peers
    with Link(config.link, config.session, Role.REMOTE, at_once=True) as link:
        if link.warning:
            print(link.warning, flush=True)
        action = RESET if is_reset else CALL
        states = request_sides(link, Role.REMOTE, action, reason, stop)
    return {side.name.lower(): state.name.lower() for side, state in states.items()}


def watch_session(config: RunConfig, reason: str) -> int:
    """Watch a session (`send_heartbeats`); returns the exit code."""
    stop = StopCondition()
    with (
        Link(config.link, config.session, Role.WATCH) as link,
        StopSocket(config.session, "watch") as stop_socket,
    ):
        for warning in filter(None, (link.warning, stop_socket.warning)):
            print(warning, flush=True)
        return send_heartbeats(link, stop, reason, stop_socket)


def request_sides(
    link: Link, role: Role, action: int, words: str, stop: Callable[[], bool]
) -> dict[Role, State]:
    """Send the request until every connected side has executed it; return their states."""
    for topic in SIDES.values():
        link.subscribe_latest(topic)
    begin, first = time.monotonic(), 0.0
    states: dict[Role, State] = {}
    stop_numbers: dict[Role, int] = {}  # number of the stop to be reset, not a later one
    while not stop():
        now = time.monotonic()
        states = {side: read_state(link, side) for side in SIDES if link.is_present(side)}
        if action == CALL:
            call_stop(link, role, words)
        else:
            for side in (s for s, state in states.items() if state is State.STOPPED):
                number = stop_numbers.setdefault(side, read_stop_count(link, side))
                call_reset(link, role, words, side, number)
        first = first or (now if states else 0.0)
        is_done = all((state is State.STOPPED) == (action == CALL) for state in states.values())
        if (first and is_done and now - first > DISCOVERY_MIN_S) or now - begin > ANSWERS_TIMEOUT_S:
            break
        time.sleep(REPEAT_S)
    return states


def read_state(link: Link, side: Role) -> State:
    """Return the reported state of a side, OFF before its first message."""
    message = link.take_latest(SIDES[side]).message
    return State.OFF if message is None else State(message.state)


def read_stop_count(link: Link, side: Role) -> int:
    """Return the reported number of stops of a side."""
    message = link.take_latest(SIDES[side]).message
    return 0 if message is None else int(message.stops)


def send_heartbeats(link: Link, stop: StopCondition, reason: str, stop_socket: StopSocket) -> int:
    """Send heartbeats until stopped; any other end of this process is an emergency stop.

    A `teleop stop` on this machine goes through this process, whose connections are open already.
    """
    for topic in SIDES.values():
        link.subscribe_latest(topic)
    deadline = time.monotonic() + ANSWERS_TIMEOUT_S
    while not all(map(link.is_present, SIDES)) and time.monotonic() < deadline and not stop():
        time.sleep(0.01)
    sides = [side for side in SIDES if link.is_present(side)]
    if not sides:
        raise TeleopError(
            f"session {link.session!r}: no master and no slave connected, nothing to watch"
        )
    names = " and ".join(side.name.lower() for side in sides)
    print(f"watching {names}; Enter stops; q, then Enter, ends the watch", flush=True)
    inputs: list[Any] = [sys.stdin] + [stop_socket] * (stop_socket.fileno() >= 0)
    while not stop():
        call_stop(link, Role.WATCH, reason, WATCH)
        if sys.stdin in select.select(inputs, [], [], BEAT_S)[0]:
            line = sys.stdin.readline()
            if line.strip() == "q":
                _send_leave(link, reason)
                return 0
            if line:
                break
            inputs.remove(sys.stdin)  # no more input from a closed terminal
        _forward_stops(link, stop_socket)
    states = request_sides(link, Role.WATCH, CALL, reason or Reason.WATCH_LOST.text, lambda: False)
    print("stopped: " + ", ".join(side.name.lower() for side in states))
    return 0


def _send_leave(link: Link, reason: str) -> None:
    """End a watch without a stop.

    Repeated for as long as a silence may last: each must be read before the token vanishes, which
    overtakes messages, and one that a busy machine drops is made up for.
    """
    deadline = time.monotonic() + SILENCE_S
    while time.monotonic() < deadline:
        call_stop(link, Role.WATCH, reason, LEAVE)
        time.sleep(BEAT_S)


def _forward_stops(link: Link, stop_socket: StopSocket) -> None:
    """Send the stops that were requested on this machine; answer with the states of the sides."""
    for request in stop_socket.take():
        if not request.is_reset:
            call_stop(link, Role.WATCH, request.reason)
    if stop_socket.is_asked:
        stop_socket.answer(
            [
                f"{side.name.lower()} {read_state(link, side).name.lower()}"
                for side in SIDES
                if link.is_present(side)
            ]
        )
