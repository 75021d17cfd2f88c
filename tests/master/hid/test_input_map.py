"""From inputs to the hand and from forces to shares: properties, without a device."""

import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.device import DeviceFault
from master.devices.hid import input_map
from master.devices.hid.driver import Controls, build_unknown_controls
from master.devices.hid.input_map import AxisConfig, ButtonsConfig, HidConfig

STICK = SimpleNamespace(axes=("x", "y", "z"), forces=("y", "x"), buttons=4)
BUTTONS = ButtonsConfig(engage=1, clutch=2, stop=3)
ENGAGE, CLUTCH, STOP = 1, 2, 4
BOTH = {"x": 1, "y": -1}
ALL = 0b1111  # the buttons of STICK
DT = 1e-3


def planned(*axes, signs=BOTH, smoothing=0.01, buttons=BUTTONS):
    config = HidConfig(axes=axes, buttons=buttons, smoothing=smoothing)
    return input_map.build_input_map(config, STICK, STICK.buttons, signs)


class Hand:
    """Reads of one plan, one after the other."""

    def __init__(self, *axes, **settings):
        self.plan = planned(*axes, **settings)
        self.memory = input_map.init_input_map(self.plan.joints)

    def read(self, *shares, buttons=0, dt=DT):
        controls = Controls((*shares, *(0.0,) * (3 - len(shares))), buttons, ALL)
        hand, self.memory = input_map.step(self.plan, self.memory, controls, controls, dt)
        return hand


def test_travel_is_the_way_from_the_middle_to_the_end_of_the_joint_that_an_axis_names():
    hand = Hand(AxisConfig("x", travel=0.05), AxisConfig("y", joint=2, travel=0.1, sign=-1))
    assert hand.read(1.0, 0.5).position == pytest.approx((0.05, 0.0, -0.05))
    assert hand.read(-0.5, 0.0).position == pytest.approx((-0.025, 0.0, 0.0))


@given(st.floats(-1.0, 1.0), st.floats(0.0, 0.9))
def test_a_dead_zone_makes_no_jump_and_leaves_the_ends(share, zone):
    out = input_map.apply_dead_zone(share, zone)
    assert abs(out) <= 1.0
    assert (out == 0.0) == (abs(share) <= zone or out == 0.0)
    assert input_map.apply_dead_zone(math.copysign(1.0, share), zone) == math.copysign(1.0, share)
    assert abs(input_map.apply_dead_zone(math.copysign(zone, share), zone)) < 1e-9
    assert abs(out) <= abs(share) + 1e-12  # rounding


def test_the_velocity_filter_has_its_time_constant():
    hand = Hand(AxisConfig("x", travel=1.0), smoothing=0.05)
    hand.read(0.0, dt=1e-4)
    speeds = [hand.read(1e-4 * k, dt=1e-4).velocity[0] for k in range(1, 501)]  # 0.05 s
    assert speeds[-1] == pytest.approx(1.0 - math.exp(-1.0), rel=5e-3)


def test_reports_that_come_more_seldom_than_ticks_are_smoothed():
    hand = Hand(AxisConfig("x", travel=0.1), smoothing=0.02)
    speeds = [hand.read(0.008 * (tick // 8)).velocity[0] for tick in range(800)]
    assert sum(speeds[400:]) / 400 == pytest.approx(0.1, rel=0.01)
    assert max(speeds[400:]) < 0.125  # unsmoothed it would be 0.8


def test_a_rate_axis_moves_only_while_engage_is_held_and_the_clutch_is_not():
    hand = Hand(AxisConfig("x", speed=0.2, sign=-1))
    assert hand.read(1.0).position == (0.0,)
    for _ in range(10):
        state = hand.read(0.5, buttons=ENGAGE)
    assert state.position[0] == pytest.approx(-0.2 * 0.5 * 10 * DT)
    assert state.velocity[0] == pytest.approx(-0.1)
    held = hand.read(0.5, buttons=ENGAGE | CLUTCH)
    assert held.position == state.position
    assert held.velocity == (0.0,)
    assert hand.read(0.0, buttons=ENGAGE).position == state.position


def test_a_middle_that_has_drifted_is_learnt_at_rest_and_never_moves_the_tip_by_itself():
    hand = Hand(AxisConfig("x", speed=0.2))

    def speed(share, buttons=ENGAGE):
        return hand.read(share, buttons=buttons).velocity[0]

    assert speed(0.08) == pytest.approx(0.2 * 0.08)  # engaged at once it creeps, as it is told
    for noise in range(1100):
        assert speed(0.08 + 0.002 * (noise % 2), buttons=0) == 0.0
    assert speed(0.08) == 0.0
    for _ in range(2000):  # engaged nothing is learnt: no step of the command
        assert speed(0.12) == pytest.approx(0.2 * 0.04)
    assert (speed(1.0), speed(-1.0)) == pytest.approx((0.2 * 0.92, -0.2))
    for _ in range(1100):
        speed(0.3, buttons=0)  # a hand that holds it is no rest
    assert speed(0.3) == pytest.approx(0.2 * 0.22)


def test_buttons_are_told_apart():
    hand = Hand(AxisConfig("x", travel=0.1))
    for mask in range(8):
        state = hand.read(0.0, buttons=mask)
        said = (state.engage, state.clutch, state.stop)
        assert said == tuple(bool(mask & bit) for bit in (ENGAGE, CLUTCH, STOP))


@pytest.mark.parametrize(("less", "more"), [("finer", "coarser"), ("weaker", "stronger")])
def test_the_buttons_of_a_scale_are_told_and_only_those_that_are_given(less, more):
    stick = AxisConfig("x", travel=0.1)
    hand = Hand(stick, buttons=ButtonsConfig(engage=1, **{less: 2, more: 4}))
    reported = [hand.read(0.0, buttons=bit) for bit in (1, 2, 4, 8, 2 | 8)]
    assert [getattr(state, less) for state in reported] == [False, True, False, False, True]
    assert [getattr(state, more) for state in reported] == [False, False, False, True, True]
    assert not getattr(Hand(stick).read(0.0, buttons=ALL), less)


def test_the_buttons_without_a_function_are_told_by_their_numbers():
    hand = Hand(AxisConfig("x", travel=0.1), buttons=ButtonsConfig(engage=1, clutch=3))
    held = [hand.read(0.0, buttons=mask).buttons for mask in (0b0000, 0b0101, 0b1111, 0b1000)]
    assert held == [(), (), (2, 4), (4,)]


def test_until_everything_is_known_the_switch_counts_as_held_and_nothing_moves():
    hand = Hand(AxisConfig("x", travel=0.1), AxisConfig("y", speed=0.1))
    start = build_unknown_controls(3)
    state, memory = input_map.step(hand.plan, hand.memory, start, start, DT)
    assert state.engage
    assert not memory.knows
    assert not state.stop  # a fault that nobody asked for
    assert not state.clutch
    assert (state.position, state.velocity) == ((0.0, 0.0), (0.0, 0.0))
    nan = math.nan
    for axes, reported, held in (
        ((nan, nan, nan), ALL, True),  # x is not known
        ((0.5, nan, nan), 0, True),  # buttons are not
        ((0.5, nan, nan), ALL & ~ENGAGE, True),  # ... one of them
        ((0.5, nan, nan), ALL & ~CLUTCH, True),
        ((0.5, nan, nan), ALL & ~STOP, True),
        ((0.5, nan, nan), ENGAGE | CLUTCH | STOP, False),  # y, of rate, rests until it is known
    ):
        controls = Controls(axes, 0, reported)
        state, after = input_map.step(hand.plan, memory, controls, controls, DT)
        assert state.engage is held
        assert after.knows is not held
        assert not state.stop
        assert not state.clutch
        assert state.velocity == (0.0, 0.0)
        assert state.position == ((0.05 if axes[0] == 0.5 else 0.0), 0.0)


def test_when_the_inputs_become_unknown_the_hand_stays_and_comes_back_without_speed():
    hand = Hand(AxisConfig("x", travel=0.1))
    hand.read(0.5)
    for share in (math.nan, math.nan):
        state = hand.read(share)
        assert (state.position, state.velocity) == ((0.05,), (0.0,))
    state = hand.read(-1.0)
    assert (state.position, state.velocity) == ((-0.1,), (0.0,))


def test_a_force_is_a_share_of_full_scale_with_the_sign_that_was_found():
    plan = planned(
        AxisConfig("x", travel=0.1, force=2.0), AxisConfig("y", travel=0.1, force=5.0, sign=-1)
    )
    # forces of the driver are y, x; y was found to push the other way, and its joint is reversed
    assert input_map.to_force_shares(plan, (1.0, 2.5)) == (0.5, 0.5)
    assert input_map.to_force_shares(plan, (-1.0, -2.5)) == (-0.5, -0.5)


@given(st.lists(st.floats(), min_size=2, max_size=2), st.sampled_from([1, -1]))
def test_whatever_is_asked_for_a_share_is_a_share(force, sign):
    plan = planned(
        AxisConfig("x", travel=0.1, force=2.0, sign=sign), AxisConfig("y", travel=0.1, force=0.1)
    )
    for share, wanted in zip(
        reversed(input_map.to_force_shares(plan, tuple(force))), force, strict=True
    ):
        assert -1.0 <= share <= 1.0
        assert not (math.isnan(wanted) and share)


@pytest.mark.parametrize(
    ("axis", "buttons", "complaint"),
    [
        (AxisConfig("rz", travel=0.1), BUTTONS, "no axis 'rz'; it has x, y, z"),
        (AxisConfig("z", travel=0.1, force=1.0), BUTTONS, "cannot push 'z', but y, x"),
        (AxisConfig("x", travel=0.1), ButtonsConfig(engage=5), "no button 5; the device has 4"),
        (AxisConfig("x", travel=0.1), ButtonsConfig(stop=9), "buttons.stop"),
    ],
)
def test_what_the_device_does_not_have_is_named(axis, buttons, complaint):
    with pytest.raises(DeviceFault, match=complaint):
        planned(axis, buttons=buttons)
