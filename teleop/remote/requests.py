"""Requests of other processes to a loop; costs microseconds while there are none."""

from typing import NamedTuple

from teleop.link import Link, ReceivedMessage
from teleop.messages import STOP_ACTIONS, EmergencyStop, Setting, text_bytes, text_of
from teleop.remote import watches
from teleop.remote.watches import ArmedWatch, Beat
from teleop.session import Reason, SessionOutline, State
from teleop.topics import SETTING, STOP, Role, role_name

CALL, RESET, WATCH, LEAVE = range(len(STOP_ACTIONS))
RELAYED = (Reason.EMERGENCY_STOP, Reason.STOP_CALLED, Reason.WATCH_LOST)


class SettingRequest(NamedTuple):
    """Request of another process to change a setting."""

    asker: int  # nonce of the process
    sequence: int  # sequence number of its message
    key: str
    value: str


class Requests(NamedTuple):
    """Requests since the last tick."""

    stop: Reason = Reason.NONE
    words: str = ""  # sender and reason of a stop
    reset: bool = False
    settings: tuple[SettingRequest, ...] = ()


_NOTHING = Requests()


class RequestListener:
    """Listens for stops, resets, watches and settings; used from the loop's thread."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._listener = link.listen((STOP, SETTING))
        self._armed: tuple[ArmedWatch, ...] = ()
        self._before = SessionOutline()

    def __call__(self, now_ns: int, stops: int = 0) -> Requests:
        """Return the requests since the last call, at `now_ns` [ns].

        A reset is valid if it gives the newest of our `stops`, so that it cannot reset a later
        stop.
        """
        messages = self._listener.drain()
        if not messages and not self._armed:
            return _NOTHING
        calls = [
            item for item in messages if item.topic is STOP and item.sender != self._link.nonce
        ]
        calls_and_bodies = [(item, EmergencyStop.unpack(item.data)) for item in calls]
        beats = [
            Beat(item.sender, item.received_ns, call.action == LEAVE)
            for item, call in calls_and_bodies
            if call.action in (WATCH, LEAVE)
        ]
        self._armed, lost = watches.update(self._armed, beats, self._is_watch, now_ns)
        requests = Requests(
            stop=Reason.WATCH_LOST if lost else Reason.NONE,
            reset=any(
                call.action == RESET
                and (call.side, call.number) == (self._link.role, stops)
                and self._link.announced(item.sender)
                for item, call in calls_and_bodies
            ),
            settings=tuple(
                _setting_request(item)
                for item in messages
                if item.topic is SETTING and self._link.announced(item.sender)
            ),
        )
        for _, call in calls_and_bodies:
            if call.action not in (RESET, WATCH, LEAVE):
                words = f"{role_name(call.role)}: {text_of(call.text)}"
                return requests._replace(stop=Reason.STOP_CALLED, words=words)
        return requests

    def relay(self, role: Role, side: SessionOutline, words: str) -> None:
        """Relay a stop that has just been executed to all processes.

        Its sender may be connected to this side only, and is not connected to the recorder.
        """
        began = side.state is State.STOPPED and self._before.state is not State.STOPPED
        self._before = side
        if began and side.reason in RELAYED:
            call_stop(self._link, role, words or side.reason.text)

    def _is_watch(self, nonce: int) -> bool:
        return self._link.present(Role.WATCH, nonce)


def call_stop(link: Link, role: Role, words: str, action: int = CALL) -> None:
    """Send one emergency stop message; a stop of any sender is executed."""
    link.publish(STOP, EmergencyStop(role=role, action=action, text=text_bytes(words)))


def call_reset(link: Link, role: Role, words: str, side: Role, number: int) -> None:
    """Request that a side resets its newest stop if its `stops` is `number`."""
    link.publish(
        STOP,
        EmergencyStop(role=role, action=RESET, side=side, number=number, text=text_bytes(words)),
    )


def _setting_request(item: ReceivedMessage) -> SettingRequest:
    setting = Setting.unpack(item.data)
    return SettingRequest(item.sender, item.sequence, text_of(setting.key), text_of(setting.value))
