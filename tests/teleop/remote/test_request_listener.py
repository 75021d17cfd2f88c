"""Requests of other processes, as a side takes them."""

from types import SimpleNamespace

import pytest

from teleop.link import ReceivedMessage
from teleop.link.rate_limit import RefusalCounter
from teleop.messages.messages import EmergencyStop
from teleop.messages.topics import STOP, Role
from teleop.remote import stop_over_link
from teleop.remote.request_listener import CALL, LEAVE, WATCH, RequestListener
from teleop.session import loop_process
from teleop.session.loop_process import PEER_TIMEOUT_NS
from teleop.session.state_machine import Reason, SessionOutline, State

MS = 1_000_000
NONCE = 7


class FakeLink:
    """A link of a side: messages that `send` has put there, of a process that may be gone."""

    role, nonce = Role.SLAVE, 1

    def __init__(self):
        self.refusals, self.here, self._messages = RefusalCounter(), True, []

    def send(self, action, now):
        call = EmergencyStop(role=Role.WATCH, action=action)
        sequence = now // MS + 1
        data = STOP.message.schema.pack(call, NONCE, sequence, now)
        self._messages.append(ReceivedMessage(STOP, bytes(data), now, NONCE, sequence, now))

    def listen(self, _topics):
        return self

    def drain(self):
        messages, self._messages = self._messages, []
        return messages

    def is_present(self, role, nonce):
        return self.here and (role, nonce) == (Role.WATCH, NONCE)

    def has_right(self, nonce, right):
        return self.here and (nonce, right) == (NONCE, "stop")


@pytest.fixture
def line():
    return FakeLink()


def watched(line):
    """A side that a process watches."""
    requests = RequestListener(line)
    line.send(WATCH, 0)
    assert requests.take_requests(0).stop is Reason.NONE
    return requests


def test_a_watch_that_leaves_is_no_stop_though_its_token_vanished_before_that_was_read(line):
    requests = watched(line)
    line.send(LEAVE, 1 * MS)
    line.here = False
    for now in (2, 3, 1000):
        assert requests.take_requests(now * MS).stop is Reason.NONE


def test_a_watch_that_vanishes_or_falls_silent_is_a_stop(line):
    requests = watched(line)
    line.here = False
    assert requests.take_requests(1 * MS).stop is Reason.WATCH_LOST
    line.here = True
    requests = watched(line)
    assert requests.take_requests(240 * MS).stop is Reason.NONE
    assert requests.take_requests(260 * MS).stop is Reason.WATCH_LOST


@pytest.mark.parametrize("action", [CALL, WATCH])
def test_nothing_else_counts_of_a_process_that_is_not_here(line, action):
    requests = RequestListener(line)
    line.here = False
    line.send(action, 0)
    assert requests.take_requests(0).stop is Reason.NONE
    line.here = True
    assert requests.take_requests(1000 * MS).stop is Reason.NONE


@pytest.mark.parametrize(
    ("fresh", "connected", "state", "lines"),
    [
        (True, True, State.ENGAGED, ["slave stopped 3", "master engaged"]),
        (True, False, State.ENGAGED, ["slave stopped 3", "master engaged"]),
        (False, True, State.ENGAGED, ["slave stopped 3", "master silent"]),
        (False, False, State.ENGAGED, ["slave stopped 3"]),
        (True, True, State.OFF, ["slave stopped 3", "master off"]),
        (True, False, State.OFF, ["slave stopped 3"]),
    ],
)
def test_a_side_says_what_its_peer_does(line, fresh, connected, state, lines):
    """One whose loop hangs is connected, and only the network leads to it; one that ends is OFF."""
    told = []
    line.is_present = lambda role: connected and role is Role.MASTER
    own = SimpleNamespace(is_asked=True, answer=told.append)
    newest = SimpleNamespace(
        is_fresh=lambda _now, limit: fresh and limit == PEER_TIMEOUT_NS,
        packet=SimpleNamespace(records={"state": [state]}),
    )
    requests = RequestListener(line, own)
    loop_process.answer_requests(
        line, requests, Role.SLAVE, SessionOutline(State.STOPPED), 3, newest, 0
    )
    assert told == [lines]


def test_a_watch_says_that_it_leaves_until_a_side_that_heard_nothing_would_have_stopped(
    monkeypatch,
):
    sent, now = [], [0.0]
    monkeypatch.setattr(stop_over_link.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(stop_over_link.time, "sleep", lambda s: now.__setitem__(0, now[0] + s))
    monkeypatch.setattr(stop_over_link, "call_stop", lambda *a: sent.append((now[0], a[-1])))
    stop_over_link._send_leave(object(), "")
    assert [action for _, action in sent] == [LEAVE] * len(sent)
    assert sent[0][0] == 0.0
    assert now[0] >= 0.25
