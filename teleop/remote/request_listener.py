"""Requests of other processes to a loop; costs microseconds while there are none."""

from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

from teleop.link import Link, ReceivedMessage
from teleop.messages.messages import STOP_ACTIONS, EmergencyStop, Setting, decode_text, encode_text
from teleop.messages.topics import SETTING, STOP, Role, format_role
from teleop.remote.stop_socket import StopSocket
from teleop.session.state_machine import Reason, SessionOutline, State

# --- watchdog processes of a session: the end of one, for any reason, is an emergency stop
# A watch sends a heartbeat every `BEAT_S` and is armed from the first one. It is lost after
# `SILENCE_S` without a heartbeat (frozen or disconnected), or when its presence token vanishes (it
# died); a LEAVE message ends it without a stop. Pure.


BEAT_S = 0.05  # [s] between two beats
SILENCE_S = 0.25  # [s] timeout: five heartbeats


class Heartbeat(NamedTuple):
    """A heartbeat."""

    watch: int  # nonce of its process
    received_ns: int  # on our clock
    leaves: bool


class ArmedWatch(NamedTuple):
    """An armed watch."""

    watch: int
    received_ns: int  # its newest heartbeat
    seen: bool  # whether its token was present


def update_watches(
    armed: tuple[ArmedWatch, ...],
    beats: Iterable[Heartbeat],
    present: Callable[[int], bool],
    now_ns: int,
) -> tuple[tuple[ArmedWatch, ...], bool]:
    """Return the watches that are armed after a tick, and whether one was lost in it.

    `armed` are those of the tick before, `beats` the heartbeats since, oldest first; `present`
    returns whether the token of a nonce is present; `now_ns` [ns] is the stamp of this tick.
    """
    armed_by_watch = {watch.watch: watch for watch in armed}
    for beat in beats:
        if beat.leaves:
            armed_by_watch.pop(beat.watch, None)
        else:
            was_seen = beat.watch in armed_by_watch and armed_by_watch[beat.watch].seen
            armed_by_watch[beat.watch] = ArmedWatch(beat.watch, beat.received_ns, was_seen)
    remaining = []
    for watch in armed_by_watch.values():
        is_present = present(watch.watch)
        silent = now_ns - watch.received_ns > SILENCE_S * 1e9
        if not silent and (is_present or not watch.seen):
            remaining.append(watch._replace(seen=is_present))
    return tuple(remaining), len(remaining) < len(armed_by_watch)


SETTINGS_PER_TICK, SETTINGS_WAITING = 4, 32  # requests: in a tick, and waiting for one
CALL, RESET, WATCH, LEAVE = range(len(STOP_ACTIONS))
RELAYED_REASONS = (Reason.EMERGENCY_STOP, Reason.STOP_CALLED, Reason.WATCH_LOST)


class SettingRequest(NamedTuple):
    """Request of another process to change a setting."""

    asker: int  # nonce of the process
    sequence: int  # sequence number of its message
    key: str
    value: str


def find_side(key: str) -> Role:
    """Return the side that has a setting: the slave those below `slave.`, the master all others."""
    return Role.SLAVE if key.startswith("slave.") else Role.MASTER


class Requests(NamedTuple):
    """Requests since the last tick."""

    stop: Reason = Reason.NONE
    stop_text: str = ""  # sender and reason of a stop
    reset: bool = False
    settings: tuple[SettingRequest, ...] = ()


_NO_REQUESTS = Requests()


class RequestListener:
    """Listens for stops, resets, watches and settings; used from the loop's thread.

    `stop_socket` is for requests from this machine, which do not pass the network.
    """

    def __init__(self, link: Link, stop_socket: StopSocket | None = None) -> None:
        self._link, self._stop_socket = link, stop_socket
        self._listener = link.listen((STOP, SETTING))
        self._armed: tuple[ArmedWatch, ...] = ()
        self._settings: deque[SettingRequest] = deque()
        self._before = SessionOutline()

    def take_requests(self, now_ns: int, stops: int = 0) -> Requests:
        """Return the requests since the last call, at `now_ns` [ns], that their senders may make.

        A reset is valid if it gives the newest of our `stops`, so that it cannot reset a later
        stop. Of settings there are `SETTINGS_PER_TICK` in a tick at most.
        """
        local = [] if self._stop_socket is None else self._stop_socket.take()
        messages = self._listener.drain()
        if not messages and not local and not self._armed and not self._settings:
            return _NO_REQUESTS
        calls = [
            item for item in messages if item.topic is STOP and item.sender != self._link.nonce
        ]
        calls_and_bodies = [
            (item, call)
            for item, call in ((item, EmergencyStop.unpack(item.data)) for item in calls)
            # a LEAVE may be read after the token of its sender has vanished; it ends no other watch
            if call.action == LEAVE
            or self._may(item, call.role, "reset" if call.action == RESET else "stop")
        ]
        beats = [
            Heartbeat(item.sender, item.received_ns, call.action == LEAVE)
            for item, call in calls_and_bodies
            if call.action in (WATCH, LEAVE)
        ]
        self._armed, lost = update_watches(
            self._armed, beats, partial(self._link.is_present, Role.WATCH), now_ns
        )
        requests = Requests(
            stop=Reason.WATCH_LOST if lost else Reason.NONE,
            reset=any(
                call.action == RESET and (call.side, call.number) == (self._link.role, stops)
                for _, call in calls_and_bodies
            )
            or any(request.is_reset and request.number == stops for request in local),
            settings=self._queue_settings(messages),
        )
        callers = [
            f"{format_role(call.role)}: {decode_text(call.text)}"
            for _, call in calls_and_bodies
            if call.action not in (RESET, WATCH, LEAVE)
        ]
        callers += [f"this machine: {request.reason}" for request in local if not request.is_reset]
        if callers:
            return requests._replace(stop=Reason.STOP_CALLED, stop_text=callers[0])
        return requests

    def count_refused(self) -> dict[str, int]:
        """Return by topic how many messages had no right tag, or came too fast."""
        return {topic.name: self._listener.count_refused(topic) for topic in (STOP, SETTING)}

    def count_forged(self) -> dict[str, int]:
        """Return by topic how many of them had a wrong tag for us."""
        return {topic.name: self._listener.count_forged(topic) for topic in (STOP, SETTING)}

    def relay(self, role: Role, side: SessionOutline, words: str) -> None:
        """Relay a stop that has just been executed to all processes.

        Its sender may be connected to this side only, and is not connected to the recorder.
        """
        began = side.state is State.STOPPED and self._before.state is not State.STOPPED
        self._before = side
        if began and side.reason in RELAYED_REASONS:
            call_stop(self._link, role, words or side.reason.text)

    @property
    def is_asked(self) -> bool:
        """Whether a request from this machine waits for an answer."""
        return self._stop_socket is not None and self._stop_socket.is_asked

    def answer(self, role: Role, side: SessionOutline, stops: int, other: Role, peer: str) -> None:
        """Answer the requests from this machine that have been executed.

        `role`, `side` and `stops` are of this process, `other` and `peer` the other side and its
        state: `SILENT` if it is connected and sends nothing, empty if it is not connected.
        """
        if self._stop_socket is not None:
            lines = [f"{role.name.lower()} {side.state.name.lower()} {stops}"]
            if peer:
                lines.append(f"{other.name.lower()} {peer}")
            self._stop_socket.answer(lines)

    def _queue_settings(self, messages: list[ReceivedMessage]) -> tuple[SettingRequest, ...]:
        """Queue new requests for settings; return those of this tick."""
        for item in messages:
            if item.topic is SETTING:
                request, role = _unpack_setting_request(item)
                if not self._may(item, role, "set"):
                    continue
                if len(self._settings) < SETTINGS_WAITING:
                    self._settings.append(request)
                else:
                    self._link.refusals.note("settings came too fast")
        count = min(SETTINGS_PER_TICK, len(self._settings))
        return tuple(self._settings.popleft() for _ in range(count))

    def _may(self, item: ReceivedMessage, role: int, right: str) -> bool:
        """Return whether a request is to be executed; one that is not is noted."""
        may = self._link.has_right(item.sender, right)
        if not may:
            self._link.refusals.note(
                f"{item.topic.name} of a {format_role(role)} without the right to {right}"
            )
        return may


def call_stop(link: Link, role: Role, words: str, action: int = CALL) -> None:
    """Send one emergency stop message; a stop of any sender is executed."""
    link.publish(STOP, EmergencyStop(role=role, action=action, text=encode_text(words)))


def call_reset(link: Link, role: Role, words: str, side: Role, number: int) -> None:
    """Request that a side resets its newest stop if its `stops` is `number`."""
    link.publish(
        STOP,
        EmergencyStop(role=role, action=RESET, side=side, number=number, text=encode_text(words)),
    )


def _unpack_setting_request(item: ReceivedMessage) -> tuple[SettingRequest, int]:
    """Return a request for a setting, and the role of its sender."""
    setting = Setting.unpack(item.data)
    key, value = decode_text(setting.key), decode_text(setting.value)
    return SettingRequest(item.sender, item.sequence, key, value), setting.role
