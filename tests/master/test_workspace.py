"""Forces of the master's own: limits, the weight of the device; and whether a hand is there."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.structs import view_struct
from master import workspace
from master.config import MasterConfig
from master.device import HandState
from master.devices.combined import CombinedConfig
from master.operator import OperatorConfig, build_operator_settings
from master.workspace import Presence, WorkspaceLimits
from teleop.coupling import Bilateral
from teleop.coupling.config import PassivityConfig
from teleop.session.state_machine import Reason, State
from tests.master.records import eight, hand_record
from tests.master.run import CONFIG, MS, Run, answer, hand

WALLS = OperatorConfig(workspace=((-0.05, 0.05),), wall=300.0, wall_damping=2.0, wall_max=2.0)
METRES, SPEEDS = st.floats(-0.08, 0.08), st.floats(-5.0, 5.0)


def walls(config, the_hand):
    """The forces of the limits where the workspace has them."""
    settings, out = view_struct(build_operator_settings(config)), eight()
    limits = WorkspaceLimits.new(low=settings.low, high=settings.high, known=True)
    workspace.compute_wall_forces(settings, limits, hand_record(the_hand), np.ones(8), out)
    return tuple(out[: len(the_hand.position)])


@given(METRES, SPEEDS)
def test_a_limit_pushes_back_inwards_and_no_harder_than_it_may(x, v):
    (force,) = walls(WALLS, HandState((x,), (v,), True))
    assert abs(force) <= WALLS.wall_max
    if abs(x) <= 0.05:
        assert force == 0.0
    else:
        assert math.copysign(1.0, force) == -math.copysign(1.0, x)


@given(st.lists(SPEEDS, min_size=1, max_size=200))
def test_a_limit_gives_back_no_more_than_was_put_in(way):
    """The energy that the wall puts into a hand that goes in and out, in small steps."""
    x, gained = 0.0, 0.0
    for v in way:
        for _ in range(20):
            before = x
            x += 1e-4 * v
            middle = HandState((0.5 * (x + before),), (v,), True)
            (force,) = walls(WALLS, middle)
            gained += force * (x - before)
    assert gained <= 1e-3


def test_an_axis_without_limits_has_none():
    config = OperatorConfig(workspace=((-0.05, 0.05),))
    far = HandState((0.0, 9.0), (0.0, 0.0), True)
    assert walls(config, far) == (0.0, 0.0)
    weight = view_struct(build_operator_settings(OperatorConfig(weight=(0.5,)))).weight
    assert tuple(weight[:2]) == (0.5, 0.0)


def test_the_wall_is_felt_in_free_motion_and_only_while_engaged():
    run = Run(MasterConfig(operator=WALLS, gate=CONFIG.gate)).engaged()
    for _ in range(30):
        run.answered(hand(0.052), force=0.0)
    assert run.output.force[0] == pytest.approx(-0.6)
    assert run.answered(hand(0.052, clutch=True), State.CLUTCHED).force == (0.0,)


def test_a_hand_that_is_outside_when_it_is_coupled_is_not_kicked_and_finds_its_limit_again():
    run = Run(MasterConfig(operator=WALLS, gate=CONFIG.gate)).engaged()

    def settled(place, **buttons):
        for _ in range(30):
            state = State.CLUTCHED if buttons else State.ENGAGED
            run.answered(hand(place, **buttons), state, force=0.0)
        return run.output.force[0]

    assert settled(0.060, clutch=True) == 0.0
    for _ in range(30):  # every tick of the way back
        run.answered(hand(0.060), force=0.0)
        assert run.output.force[0] == 0.0
    assert settled(0.062) == pytest.approx(-0.6)
    assert settled(0.055) == 0.0
    assert settled(0.057) == pytest.approx(-0.6)
    assert settled(0.0) == 0.0
    assert settled(0.052) == pytest.approx(-0.6)


def test_a_heavy_device_is_kept_from_falling_at_rest_but_not_in_a_stop():
    run = Run(MasterConfig(operator=OperatorConfig(weight=(0.4,)), gate=CONFIG.gate))
    for _ in range(5):
        run.answered(hand(engage=False), State.READY)
    assert run.output.force == pytest.approx((0.4,))
    run.answered(hand(), State.READY)
    for _ in range(20):
        run.answered(hand(), force=0.0)
    assert run.output.force == pytest.approx((0.4,))
    assert run.answered(hand(stop=True)).force == (0.0,)


def press(scale, config, force=5.0):
    """Return the force in a hand that presses, and that of the joints, of a scaled device."""
    device = CombinedConfig(force_scales=(scale, 1.0))
    run = Run(replace(config, device=device)).engaged()
    for _ in range(400):
        run.answered(hand(0.052), force=force)
    return run.output.force[0], float(run.memory.joint_force[0])


def test_the_force_scale_of_a_device_is_that_of_the_tips_not_of_walls_and_weight():
    config = replace(CONFIG, operator=replace(WALLS, weight=(0.4,), wall_damping=0.0))
    assert press(1.0, config) == pytest.approx((-1.0 - 0.6 + 0.4, -1.0), abs=1e-6)
    assert press(0.25, config) == pytest.approx((-0.25 - 0.6 + 0.4, -1.0), abs=1e-6)


def test_a_scaled_device_counts_no_more_force_than_the_slave_renders():
    """The slave limits its forces to those of an unscaled device."""
    limit = CONFIG.force.limit
    for scale in (1.0, 0.25):
        found = press(scale, CONFIG, force=1000.0)
        assert found == pytest.approx((-scale * limit, -limit), abs=1e-6)


def test_forces_of_its_own_are_no_work_of_the_coupling():
    bilateral = Bilateral(coupling=PassivityConfig())
    run = Run(MasterConfig(operator=OperatorConfig(weight=(0.4,)), gate=CONFIG.gate), bilateral)
    for k in range(200):
        state = State.READY if k < 4 else State.ENGAGED
        told = replace(answer(run.now + MS, state, force=0.0), coupling=bilateral.signature)
        run.tick(hand(1e-4 * k, engage=k > 2), told)
    assert run.state == State.ENGAGED
    assert run.output.force[0] == pytest.approx(0.4, abs=0.05)
    assert run.memory.coupling.ports[0].put_in == pytest.approx(0.0, abs=1e-9)
    assert run.memory.coupling.ports[0].taken_out == pytest.approx(0.0, abs=1e-9)


PRESENCE = OperatorConfig(presence=0.5)
DT = 1e-3


def held(*position, engage=True):
    return HandState(position, (0.0,) * len(position), engage)


def watched(memory, *hands, config=PRESENCE):
    memory, rule = memory.copy(), view_struct(build_operator_settings(config))
    for the_hand in hands:
        workspace.update_presence(rule, memory, hand_record(the_hand), DT)
    return memory


def test_a_device_that_lies_still_with_its_switch_closed_has_nobody_at_it():
    memory = watched(Presence.new(), *[held(0.1)] * 500)
    assert not memory.is_away
    memory = watched(memory, *[held(0.1)] * 5)
    assert memory.is_away


@settings(max_examples=15, deadline=None)
@given(st.floats(0.0, 1e-5), st.integers())
def test_noise_below_a_tremor_is_no_hand(most, seed):
    chance = random.Random(seed)  # noqa: S311
    assert watched(
        Presence.new(), *(held(0.1 + chance.uniform(-most, most)) for _ in range(600))
    ).is_away


@settings(max_examples=15, deadline=None)
@given(st.floats(3e-5, 1e-3), st.integers(1, 200))
def test_a_tremor_is_a_hand(amplitude, period):
    hands = [held(0.1 + amplitude * ((k // period) % 2)) for k in range(1500)]
    assert not watched(Presence.new(), *hands).is_away


def test_a_knock_does_not_bring_the_hand_back_but_letting_go_does():
    memory = watched(Presence.new(), *[held(0.1)] * 600)
    assert watched(memory, held(0.2), held(0.3), held(0.3)).is_away
    assert not watched(memory, held(0.2), held(0.3, engage=False), held(0.3)).is_away


def test_by_default_the_switch_is_trusted():
    assert not watched(Presence.new(), *[held(0.1)] * 5000, config=OperatorConfig()).is_away


def test_a_session_whose_hand_is_gone_lets_go_and_says_why():
    session = Run(MasterConfig(operator=PRESENCE)).engaged()
    while session.state == State.ENGAGED:
        session.answered(held(0.0))
    assert session.session == (State.READY, Reason.HAND_AWAY)
    assert session.output.force == (0.0,)
    session.answered(held(0.1), State.READY)
    assert session.session == (State.READY, Reason.HAND_AWAY)
    session.answered(held(0.1, engage=False), State.READY)
    session.answered(held(0.1), State.READY)
    assert session.state == State.ENGAGED
