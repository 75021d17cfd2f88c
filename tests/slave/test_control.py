"""The control law of a joint, on tendons that say what the test wants them to say."""

import math
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.law.transmission import Phase
from estimator.online.tendon_estimate import Status
from estimator.structs import to_struct, view_struct
from slave import control
from slave.control import ControlConfig, ControllerState, JointEstimate
from slave.control.joint_estimate import fuse_travels
from slave.rig_layout import EstimatedTendon, build_rig_layout
from teleop.config.arm import RoutingConfig
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS

CONFIG = ControlConfig(lead=0.010, compensation_band=0.0)
DT = 0.001
REACH = CONFIG.speed_max * DT
PAIR, ALONE = ((0, 1),), ((0,),)
UNWRITTEN = 7.0
NO_ARM = np.full((3, MAX_JOINTS), np.nan)

metres = st.floats(-0.1, 0.1)
newtons = st.floats(0.0, 40.0)


record_of = cache(to_struct)


@cache
def layout_of(joints, arms=()):
    return view_struct(build_rig_layout(joints, arms))


def tendon(tension=5.0, displacement=0.0, elongation=5e-4, status=Status.OK, force=(2.0, 1.0, 3.0)):
    record = EstimatedTendon.new(
        tension=tension,
        displacement=displacement,
        corrected_tension=math.nan,  # nothing here goes by what a model knows of a sensor
        corrected_displacement=math.nan,
        valid=not status & Status.INVALID_INPUT,
    )
    estimate = record.estimate
    estimate.distal_tension, estimate.low, estimate.high = force
    estimate.elongation, estimate.front = elongation, 0.5
    estimate.distal_displacement = displacement - elongation if record.valid else math.nan
    estimate.phase, estimate.status = int(Phase.PULL), int(status)
    return record


def tendons_of(tendons):
    """Return the tendons of a rig as one array, longer than needed, as in the loop."""
    records = EstimatedTendon.array(MAX_TENDONS)
    for k, record in enumerate(tendons):
        records[k] = record
    return records


def padded(values, length, filler=math.nan):
    return np.array([*values, *[filler] * (length - len(values))])


def step(config, joints, memory, command, motor, tendons, engaged, dt, velocity=(), arms=()):
    """Return the motor positions wanted; `memory` is changed."""
    wanted = np.full(MAX_TENDONS, UNWRITTEN)
    control.step(
        record_of(config), layout_of(joints, arms), memory, padded(command, MAX_JOINTS),
        padded(velocity, MAX_JOINTS, filler=0.0), padded(motor, MAX_TENDONS), tendons_of(tendons),
        engaged, dt, wanted,
    )  # fmt: skip
    assert (wanted[len(motor) :] == UNWRITTEN).all()
    return tuple(wanted[: len(motor)].tolist())


def joint_estimate(tendons, offset=0.0):
    """Return what is known of a joint of these tendons."""
    estimates, offsets = JointEstimate.array(MAX_JOINTS), np.full(MAX_TENDONS, offset)
    layout = layout_of((tuple(range(len(tendons))),))
    control.estimate_joints(layout, tendons_of(tendons), offsets, NO_ARM, estimates)
    return view_struct(estimates)


def offset(tendons):
    offsets = np.full(MAX_TENDONS, UNWRITTEN)
    layout = layout_of((tuple(range(len(tendons))),))
    assert control.compute_offsets(layout, tendons_of(tendons), offsets)
    return offsets[0]


def slack_side(displacement=0.0, tension=CONFIG.slack_side_tension):
    return tendon(tension, displacement, elongation=1e-5)


def engaged(tendons, command=0.0, joints=ALONE, config=CONFIG, motor=None):
    """Return the motor positions and the memory of a joint that has just engaged."""
    motor = tuple(t.displacement for t in tendons) if motor is None else motor
    memory = ControllerState.new()
    wanted = step(config, joints, memory, (command,), motor, tendons, True, DT)
    assert wanted == motor
    return wanted, memory


def moved(tendons, news, travel=0.0, joints=ALONE, config=CONFIG, velocity=()):
    """Return by how much each motor is wanted elsewhere, one tick after `tendons` engaged."""
    motor, memory = engaged(tendons, joints=joints, config=config)
    wanted = step(config, joints, memory, (travel,), motor, news, True, DT, velocity)
    return [w - m for w, m in zip(wanted, motor, strict=True)]


@given(command=metres, motor=st.tuples(metres, metres), q=metres, T=newtons, e=metres)
def test_engaging_moves_nothing_wherever_motors_and_encoders_are(command, motor, q, T, e):
    tendons = tendon(T, q, e), tendon(0.3, -q, e)
    engaged(tendons, command, PAIR, motor=motor)


def test_not_engaged_the_motors_stay_and_what_was_remembered_is_forgotten():
    _, memory = engaged((tendon(),))
    wanted = step(CONFIG, ALONE, memory, (), (0.02,), (tendon(),), False, DT)
    assert wanted == (0.02,)
    assert not memory.engaged
    again, start = (tendon(displacement=0.03),), (0.031,)
    assert step(CONFIG, ALONE, memory, (0.7,), start, again, True, DT) == start
    _, anew = engaged(again, 0.7, motor=start)
    assert memory.engaged
    assert anew.engaged
    assert memory.tendon[:2].tobytes() == anew.tendon[:2].tobytes()


@given(travel=st.floats(-0.9 * REACH, 0.9 * REACH))
def test_the_motor_goes_as_the_joint_is_asked_to_go(travel):
    assert moved([tendon()], [tendon()], travel) == pytest.approx([travel], abs=1e-15)


@given(change=st.floats(-REACH, REACH))
def test_a_share_of_the_elongation_is_made_up_for(change):
    longer = tendon(elongation=5e-4 + change)
    assert moved([tendon()], [longer]) == pytest.approx([0.95 * change], abs=1e-15)
    off = ControlConfig(compensation=0.0)
    assert moved([tendon()], [longer], config=off) == pytest.approx([0.0], abs=1e-15)


def test_an_elongation_that_wavers_within_its_dead_band_moves_no_motor():
    band = 2e-6
    config = ControlConfig(compensation_band=band)
    motor, memory = engaged((tendon(),), config=config)
    for wavers in (0.9 * band, -0.9 * band, 0.5 * band, -0.9 * band):
        seen = (tendon(elongation=5e-4 + wavers),)
        assert step(config, ALONE, memory, (0.0,), motor, seen, True, DT) == motor
    longer = (tendon(elongation=5e-4 + 10.0 * band),)
    further = step(config, ALONE, memory, (0.0,), motor, longer, True, DT)
    assert further[0] - motor[0] == pytest.approx(0.95 * 9.0 * band)


def test_a_blocked_joint_is_not_wound_up_beyond_its_finite_stiffness():
    """Motor = travel + g e with e = motor: the loop settles at travel / (1 - g)."""
    config = ControlConfig(tension_max=1000.0, compensation_band=0.0)
    motor, memory = engaged((tendon(5.0, 0.0, 0.0),), config=config)
    for _ in range(3000):
        seen = (tendon(5.0, motor[0], motor[0]),)
        motor = step(config, ALONE, memory, (1e-4,), motor, seen, True, DT)
    assert motor[0] == pytest.approx(1e-4 / 0.05, rel=1e-3)


def test_while_an_estimate_is_invalid_its_motor_stays_and_then_catches_up():
    motor, memory = engaged((tendon(),))
    longer = (tendon(elongation=5.2e-4),)
    motor = step(CONFIG, ALONE, memory, (0.0,), motor, longer, True, DT)
    for elongation in (0.0, 2e-3):
        refused = (tendon(math.nan, 0.1, elongation, Status.INVALID_INPUT),)
        motor = step(CONFIG, ALONE, memory, (1e-5,), motor, refused, True, DT)
        assert motor == pytest.approx((0.95 * 2e-5,), abs=1e-12)
    motor = step(CONFIG, ALONE, memory, (1e-5,), motor, longer, True, DT)
    assert motor == pytest.approx((0.95 * 2e-5 + 1e-5,), abs=1e-12)


def test_while_one_of_a_pair_is_invalid_the_compensation_of_the_other_stays_where_it_was():
    a, b = tendon(), slack_side()
    motor, memory = engaged((a, b), joints=PAIR)
    further = slack_side(-2e-5)  # by b, which counts most, the joint has gone on by 2e-5
    motor = step(CONFIG, PAIR, memory, (0.0,), motor, (a, further), True, DT)
    assert motor[0] == pytest.approx(-0.95 * 2e-5, rel=0.01)
    refused = tendon(math.nan, 0.1, 3e-3, Status.INVALID_INPUT)
    for tendons in ((a, refused), (a, further)):
        held = step(CONFIG, PAIR, memory, (0.0,), motor, tendons, True, DT)
        assert held[0] == pytest.approx(motor[0], abs=1e-12)


def test_the_lag_of_the_servos_is_led_by_the_velocity():
    quick = moved([tendon()], [tendon()], 1e-5, velocity=(0.002,))
    assert quick == pytest.approx([1e-5 + 0.002 * CONFIG.lead])
    limited = moved([tendon()], [tendon()], 1e-5, velocity=(1e9,), config=ControlConfig(lead=1e-4))
    assert limited == pytest.approx([1e-5 + 0.050 * 1e-4])


def test_without_an_encoder_the_motor_is_taken_to_be_where_it_was_sent():
    blind = tendon(displacement=math.nan), tendon(displacement=math.nan)
    motor, memory = engaged(blind, joints=PAIR, motor=(0.01, -0.01))
    news = tendon(displacement=math.nan, elongation=5.2e-4), tendon(displacement=math.nan)
    wanted = step(CONFIG, PAIR, memory, (0.0,), motor, news, True, DT)
    # each tells something else of the joint, half each
    assert wanted[0] - motor[0] == pytest.approx(0.95 * 1e-5, rel=0.1)


def test_near_its_limit_a_tension_is_approached_ever_slower_and_beyond_it_given_way_to():
    far = 10 * REACH
    for tension in (0.0, 10.0, 19.0, 19.9):
        (change,) = moved([tendon(tension)], [tendon(tension)], far)
        room = CONFIG.limit_gain * (CONFIG.tension_max - tension) * DT
        assert change == pytest.approx(min(room, REACH))
    (change,) = moved([tendon(22.0)], [tendon(22.0)], far)
    assert change == pytest.approx(-2.0 * CONFIG.limit_gain * DT)


def test_nothing_winds_up_while_the_limit_holds():
    full = (tendon(CONFIG.tension_max, 0.0),)
    motor, memory = engaged(full)
    for _ in range(1000):
        motor = step(CONFIG, ALONE, memory, (0.01,), motor, full, True, DT)
    assert motor == pytest.approx((0.0,), abs=1e-12)
    motor = step(CONFIG, ALONE, memory, (-1e-5,), motor, full, True, DT)
    assert motor == pytest.approx((-1e-5,), abs=1e-12)  # it comes back at once


def test_a_slack_side_tendon_is_reeled_in_paid_out_or_left_alone_by_its_own_tension():
    def change(tension):
        a = tendon(5.0, 0.0)
        return moved([a, slack_side()], [a, slack_side(tension=tension)], 1e-4, PAIR)[1]

    band, at = CONFIG.slack_side_band, CONFIG.slack_side_tension
    assert change(at - 0.9 * band) == change(at + 0.9 * band) == 0.0
    assert change(at - band - 0.1) == pytest.approx(0.1 * CONFIG.slack_side_gain * DT)
    assert change(at + band + 0.1) == pytest.approx(-0.1 * CONFIG.slack_side_gain * DT)


def test_two_tendons_that_were_tight_when_the_joint_engaged_do_not_go_on_fighting():
    """The plant: tendons of 1e-4 m/N on a joint that nothing holds."""
    compliance = 1e-4
    motor, travel, memory = (0.0, 0.0), 0.0, ControllerState.new()
    slack = -5.0 * compliance  # both at 5 N where they stand
    for k in range(4000):
        travel += 0.5 * ((motor[0] - travel) - (motor[1] + travel))
        stretch = motor[0] - travel - slack, motor[1] + travel - slack
        seen = [tendon(e / compliance, m, e) for m, e in zip(motor, stretch, strict=True)]
        motor = step(CONFIG, PAIR, memory, (0.0,), motor, seen, True, DT)
        if k == 0:
            assert motor == (0.0, 0.0)
    assert (
        max(e / compliance for e in stretch)
        < CONFIG.slack_side_tension + CONFIG.slack_side_band + 0.2
    )
    assert abs(travel) < 5e-5


ARMS = (RoutingConfig(((6e-3, 0.0), (-3e-3, 5e-3), (-4e-3, -7e-3))),)  # three for two joints
OF_ARM = ((0, 1), (2,))


@pytest.mark.parametrize("asked", [(0.0, 0.0), (2e-3, -1e-3)])
def test_three_tendons_of_two_joints_move_them_without_fighting(asked):
    """The plant: tendons of 1e-4 m/N on joints that nothing holds, tight as they engage."""
    rows, compliance = np.array(layout_of(OF_ARM, ARMS).travel[:3, :2]), 1e-4
    balance = np.array(layout_of(OF_ARM, ARMS).group[0].balance[:3])
    assert rows.T @ balance == pytest.approx(0.0, abs=1e-12)
    motor, memory = np.zeros(3), ControllerState.new()
    for k in range(4000):
        travel = np.linalg.lstsq(rows, motor)[0]
        e = motor - rows @ travel + 5.0 * compliance * balance
        seen = [tendon(T / compliance, m, T) for T, m in zip(e, motor, strict=True)]
        command = np.array(asked) * min(k / 1000.0, 1.0)
        motor = np.array(step(CONFIG, OF_ARM, memory, command, motor, seen, True, DT, (), ARMS))
        assert k > 0 or not motor.any()
    assert travel == pytest.approx(asked, abs=1e-4)
    least = min(e) / compliance
    assert abs(least - CONFIG.slack_side_tension) < CONFIG.slack_side_band + 0.1


def test_a_common_motion_of_three_slack_tendons_dies_down():
    """It is not the joints', so nobody follows it: else each would follow the two others."""
    balance = np.array(layout_of(OF_ARM, ARMS).group[0].balance[:3])
    seen, memory = [slack_side()] * 3, ControllerState.new()
    start = step(CONFIG, OF_ARM, memory, (0.0, 0.0), (0.0,) * 3, seen, True, DT, (), ARMS)
    moved = np.array(start) + 1e-5 * balance
    wanted = step(CONFIG, OF_ARM, memory, (0.0, 0.0), moved, seen, True, DT, (), ARMS)
    assert wanted - moved == pytest.approx(-0.5e-5 * balance, abs=1e-9)


@given(
    measured=st.lists(metres, min_size=3, max_size=3),
    e=st.lists(st.floats(0.0, 5e-3), min_size=3, max_size=3),
)
def test_travels_of_three_tendons_are_fused_by_least_squares(measured, e):
    layout = layout_of(OF_ARM, ARMS)
    tendons = tendons_of([tendon(elongation=x) for x in e])
    fused, root = np.array(measured), 1.0 / (1e-5 + np.array(e))  # of the weights
    fuse_travels(layout.group[0], tendons, fused)
    rows = np.array(layout.travel[:3, :2])
    travel = np.linalg.lstsq(root[:, None] * rows, root * measured)[0]
    assert fused == pytest.approx(rows @ travel, abs=1e-9)
    refused = tendons_of([tendon(), tendon(status=Status.INVALID_INPUT), tendon()])
    fused = np.array([measured[0], math.nan, measured[2]])
    fuse_travels(layout.group[0], refused, fused)
    assert fused[[0, 2]].tolist() == [measured[0], measured[2]]
    assert np.array(layout.group[0].balance[:3]) @ fused == pytest.approx(0.0, abs=1e-9)


anything = st.floats(allow_nan=True, allow_infinity=True)
seen_of_anything = st.builds(
    tendon, anything, anything, st.floats(-1e3, 1e3), st.sampled_from(Status)
)
mostly = st.sampled_from((True, True, True, False))
tick = st.tuples(anything, anything, seen_of_anything, seen_of_anything, anything, mostly)


@settings(max_examples=80)
@given(st.lists(tick, min_size=5, max_size=20))
def test_whatever_comes_in_what_comes_out_is_finite_and_within_the_speed_limit(ticks):
    motor, memory = (0.0, 0.0), ControllerState.new()
    for command, velocity, a, b, dt, on in ticks:
        was = motor
        motor = step(CONFIG, PAIR, memory, (command,), was, (a, b), on, dt, (velocity,))
        for now, before in zip(motor, was, strict=True):
            assert math.isfinite(now)
            reach = CONFIG.speed_max * min(dt, 0.005) if dt > 0.0 else 0.0
            assert abs(now - before) <= reach * (1.0 + 1e-9) + 1e-15


@pytest.mark.parametrize("what", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_no_number_holds_the_motor(what):
    assert moved([tendon()], [tendon()], math.nan) == [0.0]
    assert moved([tendon()], [tendon()], 0.0, velocity=(math.nan,)) == [0.0]
    assert all(map(math.isfinite, moved([tendon()], [tendon()], what)))


def test_the_force_on_a_joint_is_the_difference_of_its_tendons_and_so_is_its_interval():
    a = tendon(force=(4.0, 3.0, 6.0), status=Status.TIP_MOVED)
    b = tendon(force=(1.5, 1.0, 2.5), status=Status.UNINITIALISED)
    estimate = joint_estimate([a, b])
    assert (estimate.force, estimate.low, estimate.high) == (2.5, 0.5, 5.0)
    assert estimate.status == Status.TIP_MOVED | Status.UNINITIALISED
    alone = joint_estimate([a])
    assert (alone.force, alone.low, alone.high) == (4.0, 3.0, 6.0)
    assert alone.position == a.displacement - a.estimate.elongation


def test_rounding_of_the_ends_of_an_adapted_force_does_not_make_its_margin_negative():
    """A negative margin is invalid: such a force would not be rendered."""
    a = tendon(force=(4.0, 3.0, 6.0))
    for end, margin in ((3.0, 1.0), (np.nextafter(4.0, 5.0), 0.0), (math.nan, math.nan)):
        a.estimate.adapted_low = a.estimate.adapted_high = end
        assert joint_estimate([a]).margin == pytest.approx(margin, abs=0.0, nan_ok=True)


@given(travel=metres, e=st.tuples(st.floats(0.0, 5e-3), st.floats(0.0, 5e-3)))
def test_two_tendons_that_agree_tell_the_travel_of_their_joint_whatever_they_weigh(travel, e):
    start = [tendon(5.0, 2e-4, 2e-4), tendon(5.0, 3e-4, 1e-4)]  # 0 and 2e-4: 1e-4 too much each
    here = [tendon(5.0, travel + e[0], e[0]), tendon(0.1, 2e-4 - travel + e[1], e[1])]
    assert joint_estimate(start, offset(start)).position == pytest.approx(-1e-4, abs=1e-12)
    assert joint_estimate(here, offset(start)).position == pytest.approx(travel - 1e-4, abs=1e-12)


def test_where_tendons_disagree_the_one_with_less_elongation_is_believed_while_it_is_taut():
    def position(b):
        return joint_estimate([tendon(10.0, 1e-3, 1e-3), b]).position  # a says 0

    assert position(slack_side(1e-5 - 1e-4)) == pytest.approx(1e-4, rel=0.01)  # b says 1e-4
    assert position(slack_side(1e-5 - 1e-4, tension=0.02)) == 0.0
    refused = tendon(1.0, 1e-5 - 1e-4, 1e-5, Status.INVALID_INPUT)
    assert position(refused) == 0.0
    between = [position(slack_side(1e-5 - 1e-4, tension=0.05 + 0.001 * k)) for k in range(100)]
    assert all(0.0 <= x <= y for x, y in pairwise(between))


def test_nothing_of_one_joint_leaks_into_another():
    """What a joint asks for and remembers is the same beside any other joint."""
    joints, news = ((0, 1), (2,)), (tendon(elongation=5.2e-4), slack_side(-1e-5))
    results = []
    for other in (tendon(), tendon(math.nan, math.nan, 3e-3, Status.INVALID_INPUT), tendon(30.0)):
        memory, motor = ControllerState.new(), (0.0, 0.0, 0.01)
        step(CONFIG, joints, memory, (0.0, 0.0), motor, (tendon(), slack_side(), other), True, DT)
        wanted = step(CONFIG, joints, memory, (1e-5, -0.1), motor, (*news, other), True, DT)
        results.append((wanted[:2], memory.tendon[:2].tobytes()))
    assert results[0] == results[1] == results[2]
    memory = ControllerState.new()
    step(CONFIG, PAIR, memory, (0.0,), (0.0, 0.0), (tendon(), slack_side()), True, DT)
    wanted = step(CONFIG, PAIR, memory, (1e-5,), (0.0, 0.0), news, True, DT)
    assert (wanted, memory.tendon[:2].tobytes()) == results[0]


def test_offsets_are_taken_of_all_joints_or_of_none():
    layout, known = layout_of(((0, 1), (2,))), [tendon(5.0, 1e-3), tendon(5.0, 3e-3), tendon()]
    offsets = np.full(MAX_TENDONS, UNWRITTEN)
    refused = tendon(status=Status.INVALID_INPUT)
    refusing = tendons_of([*known[:1], refused, tendon()])
    assert not control.compute_offsets(layout, refusing, offsets)
    assert (offsets == UNWRITTEN).all()
    assert control.compute_offsets(layout, tendons_of(known), offsets)
    assert offsets[:3].tolist() == [offset(known[:2])] * 2 + [0.0]
