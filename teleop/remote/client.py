"""A running session from Python: its messages as values or arrays, and requests to it."""

import argparse
import atexit
import json
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from teleop.errors import TeleopError, UsageError
from teleop.link import Link, Listener
from teleop.messages.messages import Event, decode_text
from teleop.messages.topics import ANSWER, COMMAND, EVENT, STATE, TOPICS, Role, Topic, format_role
from teleop.remote.request_listener import CALL, RESET
from teleop.remote.set import await_side, request_setting
from teleop.remote.stop_over_link import SIDES, read_stop_count, request_sides
from teleop.session.config import RunConfig, read_config
from teleop.session.events import MARK, parse_press
from teleop.session.state_machine import Reason, State, to_reason

MARK_BYTES = 240  # longest text of a mark
BLOCK_S = 0.1  # [s] of messages in a block
SILENCE_S = 5.0  # [s] without a message after which a session counts as ended
_POLL_S = 0.002
_STEADY_S = 0.3  # without another stop
_TIP_FIELDS = ("position", "force", "force_low", "force_high")
_TOPICS = {topic.name: topic for topic in TOPICS}


class TipState(NamedTuple):
    """One state of the slave, in SI units; arrays have one number per joint in use."""

    time: float  # [s] when it was sent, since the first state of this iteration
    state: State  # of the slave
    reason: Reason  # why it is in that state
    position: Array  # [m] estimated tip travel, positive = pulled in
    force: Array  # [N] estimated distal force, positive = against pulling
    force_low: Array  # [N] the interval's ends
    force_high: Array  # [N]
    stamp_ns: int  # when it was sent, on the slave's clock


class SessionEvent(NamedTuple):
    """An event, or a mark, of a session."""

    source: str  # "master", "slave", "launcher" or "remote"
    text: str


class _Connection(NamedTuple):
    link: Link
    events: Listener


class StateTimeoutError(TeleopError):
    """The sides are not in the state wanted in time; `states` are those they are in."""

    def __init__(self, text: str, states: Collection[State]) -> None:
        super().__init__(text)
        self.states = states


class SessionClient:
    """A connection to a running session: listens, and asks for stops and settings.

    A context manager; used from one thread. `teleop.Session` is one, and starts the session too.

    Parameters
    ----------
    config : RunConfig
        Where the session is: its name and link.

    Raises
    ------
    TeleopError, UsageError
        On entering, as of `Link`.
    """

    def __init__(self, config: RunConfig) -> None:
        self._config = config
        self._connection: _Connection | None = None
        self._heard_s = 0.0

    def __enter__(self) -> Self:
        self._connect()
        try:
            await_side(self._open.link, self._config, Role.SLAVE)
        except BaseException:
            self._disconnect()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._disconnect()

    @property
    def name(self) -> str:
        """Name of the session."""
        return self._config.session

    def states(self, duration: float | None = None) -> Iterator[TipState]:
        """Iterate over the slave's states from now on, every one of them (1 kHz by default).

        Parameters
        ----------
        duration : float, optional
            [s] of states, after which the iteration ends; without it, with the session.

        Raises
        ------
        TeleopError
            The session has ended.
        """
        begin_ns: int | None = None
        for block in self.blocks(duration):
            joints = int(block["joints"][0])
            begin_ns = int(block["stamp_ns"][0]) if begin_ns is None else begin_ns
            tips = (block[name][:, :joints] for name in _TIP_FIELDS)
            heads = (block[name].tolist() for name in ("stamp_ns", "state", "reason"))
            for stamp, state, reason, *values in zip(*heads, *tips, strict=True):
                position, force, low, high = values
                seconds = (stamp - begin_ns) * 1e-9
                if duration is not None and seconds >= duration:  # a reader may be behind
                    return
                yield TipState(
                    seconds, State(state), to_reason(reason), position, force, low, high, stamp
                )

    def blocks(
        self, duration: float | None = None, topic: str = STATE.name, period: float = BLOCK_S
    ) -> Iterator[NDArray[Any]]:
        """Iterate over blocks of messages from now on, as structured arrays.

        Parameters
        ----------
        duration : float, optional
            [s] after which the iteration ends; without it, with the session.
        topic : str
            "state", "command", "hand", "tendons", ...: a topic of docs/reference/messages.md.
        period : float
            [s] of messages in a block.

        Yields
        ------
        structured array of shape (messages,)
            Its fields are those of the message, arrays among them with all 8 joints or 16 tendons.
            Never empty.

        Raises
        ------
        UsageError
            There is no such topic.
        TeleopError
            The session has ended.
        """
        if topic not in _TOPICS:
            raise UsageError(f"topic {topic!r}: allowed are {', '.join(_TOPICS)}")
        dtype = _TOPICS[topic].message.schema.dtype
        end_s = time.monotonic() + (np.inf if duration is None else duration)
        with self._listen(_TOPICS[topic]) as listener:
            while True:
                left_s = end_s - time.monotonic()
                time.sleep(max(0.0, min(period, left_s)))
                data = [item.data for item in listener.drain()]
                if data:
                    self._heard_s = time.monotonic()
                    yield np.frombuffer(b"".join(data), dtype)
                else:
                    self._require_running()
                if left_s <= period:
                    return

    def events(self) -> list[SessionEvent]:
        """Return the events and marks since the last call; without waiting."""
        messages = (Event.unpack(item.data) for item in self._open.events.drain())
        return [SessionEvent(format_role(each.role), decode_text(each.text)) for each in messages]

    def wait_for(self, state: str | State, timeout: float = 20.0) -> None:
        """Wait until master and slave are in a state.

        Parameters
        ----------
        state : str or State
            "ready", "engaged", "clutched", "holding", "fault", "stopped" or "off".
        timeout : float
            [s]

        Raises
        ------
        UsageError
            There is no such state.
        StateTimeoutError
            They are not within `timeout`; says in which state they are.
        TeleopError
            The session has ended.
        """
        wanted = _parse_state(state)
        newest: dict[str, tuple[State, Reason]] = {}
        end_s = time.monotonic() + timeout
        with self._listen(STATE, COMMAND, sampled=True) as listener:
            while True:
                for item in listener.drain():
                    self._heard_s = time.monotonic()
                    head = np.frombuffer(item.data, item.topic.message.schema.dtype)[0]
                    newest[item.topic.name] = (
                        State(int(head["state"])),
                        to_reason(int(head["reason"])),
                    )
                states = [now for now, _ in newest.values()]
                if len(states) == len(SIDES) and all(now is wanted for now in states):
                    return
                if time.monotonic() >= end_s:
                    break
                self._require_running()
                time.sleep(_POLL_S)
        sides = [
            f"the {side.name.lower()} {_describe(newest.get(topic.name))}"
            for side, topic in SIDES.items()
        ]
        raise StateTimeoutError(
            f"session {self.name!r} is not {wanted.name.lower()} within {timeout:g} s: "
            f"{', '.join(sides)}",
            states,
        )

    def wait_for_button(self, buttons: Collection[int], timeout: float | None = None) -> int:
        """Wait until a button of the haptic device is pressed, and return its number.

        Parameters
        ----------
        buttons : collection of int
            Numbers that count, from 1; of buttons without a function (`master.device.buttons`).
        timeout : float, optional
            [s]; without it, as long as the session runs.

        Raises
        ------
        TeleopError
            None was pressed within `timeout`, or the session has ended.
        """
        end_s = time.monotonic() + (np.inf if timeout is None else timeout)
        with self._listen(EVENT) as listener:
            while time.monotonic() < end_s:
                for item in listener.drain():
                    button = parse_press(decode_text(Event.unpack(item.data).text))
                    if button is not None and button in buttons:
                        return button
                self._require_running()
                time.sleep(_POLL_S)
        raise TeleopError(f"session {self.name!r}: no button was pressed within {timeout:g} s")

    def set(self, key: str, value: object) -> str:
        """Change a setting of the running session, as `teleop set` does.

        Parameters
        ----------
        key : str
            As in a config, the "master." may be left out: "force.scale", "operator.lock",
            "operator.position_scale"; of a simulated rig also
            "slave.rig.joints.0.environment.stiffness", and position, damping and dissipation.
        value : object
            Plain data as in a config; scales of force and environments get there in 0.5 s.

        Returns
        -------
        str
            The answer of the side that has the setting.

        Raises
        ------
        UsageError
            That side refuses the key or the value.
        TeleopError
            It does not answer.
        """
        return self._request_setting(key, json.dumps(value))

    def emergency_stop(self, reason: str = "a Python program") -> None:
        """Stop both sides; `TeleopError` unless both say that they have stopped."""
        self._request(CALL, reason)
        self._await_steady_stops()

    def reset_stop(self, reason: str = "a Python program") -> None:
        """Take the emergency stop back; `TeleopError` if a side does not say so."""
        self._request(RESET, reason)

    def mark(self, text: str) -> None:
        """Mark this moment: the master makes an event of it, for the recording and all who listen.

        Parameters
        ----------
        text : str
            At most `MARK_BYTES`, one line.

        Raises
        ------
        UsageError
            It is longer, or this process may not change settings.
        TeleopError
            The master does not answer.
        """
        if len(text.encode()) > MARK_BYTES or not text.isprintable():
            raise UsageError(f"mark {text[:20]!r}: must be one line of at most {MARK_BYTES} bytes")
        self._request_setting(MARK, text)

    def _connect(self) -> None:
        link = Link(self._config.link, self._config.session, Role.REMOTE).__enter__()
        self._connection, self._heard_s = _Connection(link, link.listen((EVENT,))), time.monotonic()
        atexit.register(self._disconnect)  # of a program that does not

    def _disconnect(self) -> None:
        atexit.unregister(self._disconnect)
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.link.__exit__(None, None, None)

    @property
    def _open(self) -> "_Connection":
        if self._connection is None:
            raise UsageError(f"session {self.name!r}: not open; use it in a `with` block")
        return self._connection

    def _require_running(self) -> None:
        """Raise `TeleopError` if the session has ended."""
        silent_s = time.monotonic() - self._heard_s
        if silent_s > SILENCE_S and not self._open.link.is_present(Role.SLAVE):
            raise TeleopError(f"session {self.name!r}: no slave answers any more; it has ended")

    @contextmanager
    def _listen(self, *topics: Topic[Any], sampled: bool = False) -> Iterator[Listener]:
        listener = self._open.link.listen(topics, topics if sampled else ())
        try:
            yield listener
        finally:
            listener.close()

    def _request_setting(self, key: str, value: str) -> str:
        self._require_running()
        with self._listen(ANSWER) as listener:
            return request_setting(self._open.link, listener, key, value)

    def _await_steady_stops(self) -> None:
        """Wait for repetitions of our stop that are on their way: a reset names the last one."""
        link, end_s = self._open.link, time.monotonic() + SILENCE_S
        counts, since_s = None, 0.0
        while (now_s := time.monotonic()) < end_s:
            newest = [read_stop_count(link, side) for side in SIDES]
            if newest != counts:
                counts, since_s = newest, now_s
            if now_s - since_s > _STEADY_S:
                return
            time.sleep(_POLL_S)

    def _request(self, action: int, reason: str) -> None:
        self._require_running()
        states = request_sides(self._open.link, Role.REMOTE, action, reason, lambda: False)
        done = {s for s, now in states.items() if (now is State.STOPPED) == (action == CALL)}
        missing = [side.name.lower() for side in SIDES if side not in done]
        if missing:
            word = "stopped" if action == CALL else "reset"
            raise TeleopError(
                f"session {self.name!r}: {' and '.join(missing)} did not say that it has {word}"
            )


def join_session(name: str = "", config: str | Path | None = None) -> SessionClient:
    """Return a connection to a running session, to be used in a `with` block.

    Parameters
    ----------
    name : str
        As listed by `teleop sessions`; empty for the only one of this user on this machine.
    config : path, optional
        Config file of a session on other machines: its `session` and `link`.

    Raises
    ------
    UsageError
        There is no such session, or it is not said which of several.
    """
    path = None if config is None else Path(config)
    words = argparse.Namespace(config=path, overrides=[], session=name)
    return SessionClient(read_config(words).load(RunConfig))


def _parse_state(state: str | State) -> State:
    try:
        return state if isinstance(state, State) else State[str(state).upper()]
    except KeyError:
        allowed = ", ".join(each.name.lower() for each in State)
        raise UsageError(f"state {state!r}: allowed are {allowed}") from None


def _describe(known: tuple[State, Reason] | None) -> str:
    if known is None:
        return "has not sent a message"
    state, reason = known
    return f"is {state.name.lower()} ({reason.text})"
