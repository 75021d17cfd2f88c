"""Whether anybody is there: the switch of a device that lies still does not count for ever."""

import random

from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.records import view_struct
from master import local
from master.config import MasterConfig
from master.device import HandState
from master.local import Presence
from master.operator import OperatorConfig, build_operator_settings
from teleop.session.state_machine import Reason, State
from tests.master.records import hand_record
from tests.master.run import Run

CONFIG = OperatorConfig(presence=0.5)
DT = 1e-3


def held(*position, engage=True):
    return HandState(position, (0.0,) * len(position), engage)


def run(memory, *hands, config=CONFIG):
    memory, rule = memory.copy(), view_struct(build_operator_settings(config))
    for hand in hands:
        local.update_presence(rule, memory, hand_record(hand), DT)
    return memory


def test_a_device_that_lies_still_with_its_switch_closed_has_nobody_at_it():
    memory = run(Presence.new(), *[held(0.1)] * 500)
    assert not memory.is_away
    memory = run(memory, *[held(0.1)] * 5)
    assert memory.is_away


@settings(deadline=None)
@given(st.floats(0.0, 1e-5), st.integers())
def test_noise_below_a_tremor_is_no_hand(most, seed):
    chance = random.Random(seed)  # noqa: S311
    assert run(
        Presence.new(), *(held(0.1 + chance.uniform(-most, most)) for _ in range(600))
    ).is_away


@settings(deadline=None)
@given(st.floats(3e-5, 1e-3), st.integers(1, 200))
def test_a_tremor_is_a_hand(amplitude, period):
    hands = [held(0.1 + amplitude * ((k // period) % 2)) for k in range(3000)]
    assert not run(Presence.new(), *hands).is_away


def test_a_knock_does_not_bring_the_hand_back_but_letting_go_does():
    memory = run(Presence.new(), *[held(0.1)] * 600)
    assert run(memory, held(0.2), held(0.3), held(0.3)).is_away
    assert not run(memory, held(0.2), held(0.3, engage=False), held(0.3)).is_away


def test_a_device_with_other_axes_than_before_was_touched():
    memory = run(Presence.new(), *[held(0.1)] * 400)
    memory = run(memory, *[held(0.1, 0.1)] * 400)
    assert not memory.is_away
    assert run(memory, *[held(0.1, 0.1)] * 200).is_away


def test_by_default_the_switch_is_trusted():
    assert not run(Presence.new(), *[held(0.1)] * 5000, config=OperatorConfig()).is_away


def test_a_session_whose_hand_is_gone_lets_go_and_says_why():
    session = Run(MasterConfig(operator=CONFIG)).engaged()
    while session.state == State.ENGAGED:
        session.answered(held(0.0))
    assert session.session == (State.READY, Reason.HAND_AWAY)
    assert session.output.force == (0.0,)
    session.answered(held(0.1), State.READY)
    assert session.session == (State.READY, Reason.HAND_AWAY)
    session.answered(held(0.1, engage=False), State.READY)
    session.answered(held(0.1), State.READY)
    assert session.state == State.ENGAGED
