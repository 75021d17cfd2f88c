"""Looking for what went away: nothing that fails on the way ends it."""

import threading

from master.device import DeviceFault
from master.devices.hid import device
from master.devices.hid.device import DeviceReconnection
from master.devices.hid.search import DeviceNotFoundError
from studies.testbed.processes import wait_for_condition


class Thing:
    """Something that was open; ends when it is let."""

    def __init__(self, ends=True):
        self.free, self.asked = threading.Event(), 0
        if ends:
            self.free.set()

    def end(self, patience_s=0.0):
        self.asked += 1
        return self.free.wait(patience_s)


def seek(broken, *events):
    """Look for what events bring, one a look: an exception, or the thing itself."""
    left, seen = list(events), []

    def open_again():
        event = left.pop(0) if len(left) > 1 else left[0]
        seen.append(event)
        if isinstance(event, Exception):
            raise event
        return event

    return DeviceReconnection(broken, open_again), seen


def test_whatever_a_look_fails_with_another_one_follows(monkeypatch):
    monkeypatch.setattr(device, "POLL_PERIOD_S", 0.001)
    thing = Thing()
    errors = (
        DeviceNotFoundError("no"),
        DeviceFault("not yet"),
        RuntimeError("odd"),
        KeyError("path"),
    )
    looking, _ = seek(Thing(), *errors, thing)
    assert wait_for_condition(lambda: looking.found is thing, 5.0)


def test_what_goes_on_failing_is_told_of(monkeypatch):
    monkeypatch.setattr(device, "POLL_PERIOD_S", 0.001)
    for error, words in (
        (DeviceFault("not_ready_reason"), "not_ready_reason"),
        (RuntimeError("odd"), "odd"),
    ):
        looking, _ = seek(Thing(), error)
        assert wait_for_condition(lambda looking=looking: looking.trouble, 5.0)
        assert words in looking.trouble
        looking.end(5.0)


def test_nothing_is_opened_before_what_broke_has_said_its_last_word(monkeypatch):
    monkeypatch.setattr(device, "POLL_PERIOD_S", 0.01)
    broken, thing = Thing(ends=False), Thing()
    looking, seen = seek(broken, thing)
    assert wait_for_condition(lambda: broken.asked > 3, 5.0)
    assert seen == []
    broken.free.set()
    assert wait_for_condition(lambda: looking.found is thing, 5.0)
