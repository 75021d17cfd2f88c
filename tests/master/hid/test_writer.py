"""The writing thread: the plan of what to write is pure, the thread is watched from outside."""

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.device import DeviceFault
from master.devices.hid import connection
from master.devices.hid.connection import REARM_PERIOD_S, Writer, WriterState, step
from studies.testbed.processes import wait_for_condition


class TwoAxes:
    """A driver whose reports can be read: (axis, force), and ('start', axis) to remind."""

    forces = ("x", "y")

    def encode(self, force, arm):
        reports = tuple(f"{axis} {share:g}".encode() for axis, share in zip("xy", force))  # noqa: B905
        return reports + ((b"start",) if arm else ())

    def silence(self):
        return (b"x 0", b"y 0", b"off")


class Sink:
    """Keeps what is written; fails, or hangs, when told to."""

    def __init__(self):
        self.written, self.closed = [], threading.Event()
        self.fails, self.failing, self.free = False, 0, threading.Event()
        self.free.set()
        self.waiting = threading.Event()

    def write(self, report):
        if not self.free.is_set():
            self.waiting.set()
            self.free.wait(10)
        if self.fails or self.failing:
            self.failing -= 1
            raise DeviceFault("gone")
        assert not self.closed.is_set()
        self.written.append(report)

    def close(self):
        self.closed.set()


@pytest.fixture
def sink():
    return Sink()


@pytest.fixture
def thread(sink):
    thread = Writer(sink, TwoAxes())
    yield thread
    sink.free.set()
    assert thread.end(5.0)


def test_the_first_force_is_armed_and_then_only_changes_are_written():
    due, memory = step(TwoAxes(), WriterState(), (0.5, 0.0), 1.0)
    assert due == (b"x 0.5", b"y 0", b"start")
    due, memory = step(TwoAxes(), memory, (0.5, 0.0), 1.001)
    assert due == ()
    due, memory = step(TwoAxes(), memory, (0.5, 0.25), 1.002)
    assert due == (b"y 0.25",)
    due, memory = step(TwoAxes(), memory, (0.5, 0.0), 1.003)
    assert due == (b"y 0",)


class Log(Sink):
    """Keeps beats and reports in one list."""

    def beat(self):
        if self.fails:
            raise DeviceFault("nobody hears")
        self.written.append("beat")


def test_before_it_is_armed_a_force_is_told_of_by_a_beat():
    log = Log()
    thread = Writer(log, TwoAxes(), log.beat)
    thread.post((0.5, 0.0))
    assert wait_for_condition(lambda: b"start" in log.written, 5.0)
    assert log.written[0] == "beat"
    log.fails = True
    assert wait_for_condition(lambda: (thread.post((0.5, 0.0)), thread.failure)[1], 5.0)
    assert str(thread.failure) == "nobody hears"
    assert thread.end(5.0)


@given(st.lists(st.tuples(st.sampled_from([0.0, 0.5, -1.0]), st.floats(1e-4, 0.2)), max_size=60))
def test_over_any_script_the_device_is_up_to_date_and_reminded_in_time(script):
    now, memory, state, reminded = 0.0, WriterState(), {}, None
    for force, wait in script:
        now += wait
        due, memory = step(TwoAxes(), memory, (force, -force), now)
        for report in due:
            if report == b"start":
                reminded = now
            else:
                axis, share = report.decode().split()
                state[axis] = float(share)
        assert state == {"x": force, "y": -force}
        assert now - reminded < REARM_PERIOD_S


def test_while_a_write_waits_the_newest_force_wins(thread, sink):
    sink.free.clear()
    thread.post((0.1, 0.0))
    assert sink.waiting.wait(5.0)
    for share in (0.2, 0.3, 0.4):
        thread.post((share, 0.0))
    sink.free.set()
    assert wait_for_condition(lambda: b"x 0.4" in sink.written, 5.0)
    assert not {b"x 0.2", b"x 0.3"} & set(sink.written)


def test_a_force_that_was_posted_before_a_stall_is_not_started_after_it(sink):
    now = [0.0]
    thread = Writer(sink, TwoAxes(), clock=lambda: now[0])
    sink.free.clear()
    thread.post((0.1, 0.0))
    assert sink.waiting.wait(5.0)
    thread.post((0.9, 0.0))
    now[0] = connection.POST_TIMEOUT_S + 0.01
    sink.free.set()
    assert wait_for_condition(lambda: b"x 0" in sink.written, 5.0)
    assert b"x 0.9" not in sink.written
    assert thread.end(5.0)


def test_of_its_last_reports_one_that_fails_keeps_none_of_the_others_back(sink):
    thread = Writer(sink, TwoAxes())
    sink.failing = 1
    assert thread.end(5.0)
    assert sink.written == [b"y 0", b"off"]


def test_after_a_failure_the_device_may_still_listen(thread, sink):
    sink.failing = 1
    thread.post((0.5, 0.0))
    assert wait_for_condition(lambda: sink.written == [b"x 0", b"y 0", b"off"], 5.0)


def test_a_defect_of_a_driver_leaves_no_force_and_is_not_kept_quiet(sink, monkeypatch):
    class Broken(TwoAxes):
        def encode(self, force, arm):
            return super().encode(force, arm) if force[0] < 0.6 else 1 / 0

    crashes = []
    monkeypatch.setattr(threading, "excepthook", lambda crash: crashes.append(crash.exc_type))
    thread = Writer(sink, Broken())
    thread.post((0.5, 0.0))
    assert wait_for_condition(lambda: b"x 0.5" in sink.written, 5.0)
    thread.post((0.7, 0.0))
    assert wait_for_condition(lambda: sink.written[-1] == b"off", 5.0)
    assert thread.failure is not None
    assert thread.end(5.0)
    assert crashes == [ZeroDivisionError]


def test_the_end_does_not_wait_for_a_write_that_hangs_but_closes_after_it(sink):
    thread = Writer(sink, TwoAxes())
    sink.free.clear()
    thread.post((0.5, 0.0))
    assert sink.waiting.wait(5.0)
    assert not thread.end(0.01)
    assert not sink.closed.is_set()
    sink.free.set()
    assert sink.closed.wait(5.0)
    assert sink.written[-1] == b"off"
