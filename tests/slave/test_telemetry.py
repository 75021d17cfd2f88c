"""What the slave tells listeners: each state of the session once, with its place."""

import pytest

from slave import loop, telemetry
from slave.config import SlaveConfig
from slave.loop_records import NO_POSITION, NO_SAMPLE, NOT_CALIBRATED, NOT_READY_TEXT
from slave.telemetry import Telemetry
from slave.tendon_config import TendonConfig
from teleop.session.state_machine import Reason, State
from tests.slave.slave_bench import SlaveBench

JOINTS = ((0, 1), (2,))
MODELS = [TendonConfig(effective_friction=0.8).build_model()] * 3
NAMED = f"fault: {Reason.TENDON_BROKEN.text}: joint 1, tendon b"


class Silent:
    def publish(self, *_):
        pass

    publish_packet = publish

    def skip_unsubscribed(self, _topic):
        return False


@pytest.fixture
def said(monkeypatch):
    lines = []
    monkeypatch.setattr(telemetry, "publish_event", lambda *words: lines.append(words[-1]))
    return lines


@pytest.fixture
def memory_and_telemetry():
    """Return what a slave remembers, to be set, and what tells of it."""
    return started()


def started(not_ready_text=""):
    model = loop.build_rig_model(JOINTS, MODELS, not_ready_text)
    bench = SlaveBench(model, SlaveConfig(tendons=(TendonConfig(effective_friction=0.8),)), True)
    return bench.memory, Telemetry(Silent(), model, bench.slave)


def enter(memory, state, reason):
    memory.session.state, memory.session.reason = state, reason


def find(memory, tendon):
    """Let the fault detection find this tendon broken, or nothing if it is None."""
    memory.detected_fault = Reason.NONE if tendon is None else Reason.TENDON_BROKEN
    memory.faulty_tendon = -1 if tendon is None else tendon


def test_a_fault_keeps_the_place_where_it_began_and_is_told_once(said, memory_and_telemetry):
    memory, telemetry = memory_and_telemetry
    enter(memory, State.FAULT, Reason.TENDON_BROKEN)
    for tendon in (1, None, 1, 2, None):
        find(memory, tendon)
        telemetry.publish(0.0)
        assert telemetry.detail == "joint 1, tendon b"
    assert said == [NAMED]


def test_a_fault_that_comes_again_is_told_again_and_where(said, memory_and_telemetry):
    memory, telemetry = memory_and_telemetry
    broken, ready = (State.FAULT, Reason.TENDON_BROKEN), (State.READY, Reason.RELEASED)
    for side, tendon in ((broken, 1), (ready, None), (broken, 2)):
        enter(memory, *side)
        find(memory, tendon)
        telemetry.publish(0.0)
    assert said[0] == NAMED
    assert said[2] == f"fault: {Reason.TENDON_BROKEN.text}: joint 2, tendon a"


def test_while_not_usable_every_new_reason_is_told(said):
    memory, telemetry = started("its calibration is of another rig")
    for why in (NO_SAMPLE, NO_SAMPLE, NOT_CALIBRATED, NO_POSITION):
        memory.readiness = why
        telemetry.publish(0.0)
    assert [line.split(": ", 2)[-1] for line in said] == [
        NOT_READY_TEXT[NO_SAMPLE],
        "its calibration is of another rig",
        NOT_READY_TEXT[NO_POSITION],
    ]
