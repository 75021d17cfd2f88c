"""The control law of a joint, on tendons that say what the test wants them to say."""

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.online import Status, TendonEstimate
from estimator.transmission import Phase
from slave.control import Control, ControlConfig, TendonSeen, joint_estimate, offset, step

CONFIG = ControlConfig(lead=0.010)
DT = 0.001
REACH = CONFIG.speed_max * DT
PAIR, ALONE = ((0, 1),), ((0,),)

metres = st.floats(-0.1, 0.1)
newtons = st.floats(0.0, 40.0)


def tendon(tension=5.0, displacement=0.0, elongation=5e-4, status=Status.OK, force=(2.0, 1.0, 3.0)):
    distal = math.nan if status & Status.INVALID_INPUT else displacement - elongation
    estimate = TendonEstimate(*force, elongation, distal, 0.5, Phase.PULL, status)
    valid = not status & Status.INVALID_INPUT
    return TendonSeen(tension, displacement, elongation, valid, estimate)


def loose(displacement=0.0, tension=CONFIG.loose_tension):
    return tendon(tension, displacement, elongation=1e-5)


def engaged(tendons, command=0.0, joints=ALONE, config=CONFIG, motor=None):
    """Return the motor positions and the memory of a joint that has just engaged."""
    motor = tuple(t.displacement for t in tendons) if motor is None else motor
    wanted, memory = step(config, joints, Control(), (command,), motor, tendons, True, DT)
    assert wanted == motor
    return wanted, memory


def moved(tendons, news, travel=0.0, joints=ALONE, config=CONFIG, velocity=()):
    """Return by how much each motor is wanted elsewhere, one tick after `tendons` engaged."""
    motor, memory = engaged(tendons, joints=joints, config=config)
    wanted, _ = step(config, joints, memory, (travel,), motor, news, True, DT, velocity)
    return [w - m for w, m in zip(wanted, motor, strict=True)]


@given(command=metres, motor=st.tuples(metres, metres), q=metres, T=newtons, e=metres)
def test_engaging_moves_nothing_wherever_motors_and_encoders_are(command, motor, q, T, e):
    tendons = tendon(T, q, e), tendon(0.3, -q, e)
    engaged(tendons, command, PAIR, motor=motor)


@given(command=metres, q=metres, T=st.floats(0.5, 15.0), e=st.floats(0.0, 5e-3))
def test_engaged_on_a_command_that_stays_the_driving_motor_stays(command, q, T, e):
    tendons = tendon(T, q, e), loose(-q)
    motor, memory = engaged(tendons, command, PAIR)
    for _ in range(5):
        motor, memory = step(CONFIG, PAIR, memory, (command,), motor, tendons, True, DT)
    assert motor == pytest.approx((q, -q), abs=1e-12)


def test_not_engaged_the_motors_stay_and_what_was_remembered_is_forgotten():
    _, memory = engaged((tendon(),))
    wanted, memory = step(CONFIG, ALONE, memory, (), (0.02,), (tendon(),), False, DT)
    assert wanted == (0.02,)
    assert memory == Control()


@given(travel=st.floats(-0.9 * REACH, 0.9 * REACH))
def test_the_motor_goes_as_the_joint_is_asked_to_go(travel):
    assert moved([tendon()], [tendon()], travel) == pytest.approx([travel], abs=1e-15)


def test_of_a_pair_the_motor_of_b_goes_the_other_way():
    a_drives, b_drives = (tendon(), loose()), (loose(), tendon())
    assert moved(a_drives, a_drives, 2e-5, PAIR)[0] == pytest.approx(2e-5)
    assert moved(b_drives, b_drives, -2e-5, PAIR)[1] == pytest.approx(2e-5)


@given(change=st.floats(-REACH, REACH))
def test_a_share_of_the_elongation_is_made_up_for(change):
    longer = tendon(elongation=5e-4 + change)
    assert moved([tendon()], [longer]) == pytest.approx([0.95 * change], abs=1e-15)
    off = ControlConfig(compensation=0.0)
    assert moved([tendon()], [longer], config=off) == pytest.approx([0.0], abs=1e-15)


def test_a_blocked_joint_is_not_wound_up_beyond_its_finite_stiffness():
    """Motor = travel + g e with e = motor: the loop settles at travel / (1 - g)."""
    config = ControlConfig(tension_max=1000.0)
    motor, memory = engaged((tendon(5.0, 0.0, 0.0),), config=config)
    for _ in range(3000):
        seen = (tendon(5.0, motor[0], motor[0]),)
        motor, memory = step(config, ALONE, memory, (1e-4,), motor, seen, True, DT)
    assert motor[0] == pytest.approx(1e-4 / 0.05, rel=1e-3)


def test_while_an_estimate_is_invalid_its_motor_stays_and_then_catches_up():
    motor, memory = engaged((tendon(),))
    longer = (tendon(elongation=5.2e-4),)
    motor, memory = step(CONFIG, ALONE, memory, (0.0,), motor, longer, True, DT)
    for elongation in (0.0, 2e-3):
        refused = (tendon(math.nan, 0.1, elongation, Status.INVALID_INPUT),)
        motor, memory = step(CONFIG, ALONE, memory, (1e-5,), motor, refused, True, DT)
        assert motor == pytest.approx((0.95 * 2e-5,), abs=1e-12)
    motor, memory = step(CONFIG, ALONE, memory, (1e-5,), motor, longer, True, DT)
    assert motor == pytest.approx((0.95 * 2e-5 + 1e-5,), abs=1e-12)


def test_while_one_of_a_pair_is_invalid_the_compensation_of_the_other_stays_where_it_was():
    a, b = tendon(), loose()
    motor, memory = engaged((a, b), joints=PAIR)
    further = loose(-2e-5)  # by b, which counts most, the joint has gone on by 2e-5
    motor, memory = step(CONFIG, PAIR, memory, (0.0,), motor, (a, further), True, DT)
    assert motor[0] == pytest.approx(-0.95 * 2e-5, rel=0.01)
    refused = tendon(math.nan, 0.1, 3e-3, Status.INVALID_INPUT)
    for tendons in ((a, refused), (a, further)):
        held, memory = step(CONFIG, PAIR, memory, (0.0,), motor, tendons, True, DT)
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
    wanted, _ = step(CONFIG, PAIR, memory, (0.0,), motor, news, True, DT)
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
        motor, memory = step(CONFIG, ALONE, memory, (0.01,), motor, full, True, DT)
    assert motor == pytest.approx((0.0,), abs=1e-12)
    motor, _ = step(CONFIG, ALONE, memory, (-1e-5,), motor, full, True, DT)
    assert motor == pytest.approx((-1e-5,), abs=1e-12)  # it comes back at once


def test_a_loose_tendon_is_reeled_in_paid_out_or_left_alone_by_its_own_tension():
    def change(tension):
        a = tendon(5.0, 0.0)
        return moved([a, loose()], [a, loose(tension=tension)], 1e-4, PAIR)[1]

    band, at = CONFIG.loose_band, CONFIG.loose_tension
    assert change(at - 0.9 * band) == change(at + 0.9 * band) == 0.0
    assert change(at - band - 0.1) == pytest.approx(0.1 * CONFIG.loose_gain * DT)
    assert change(at + band + 0.1) == pytest.approx(-0.1 * CONFIG.loose_gain * DT)


def test_a_loose_tendon_follows_the_tip_that_the_other_motor_moved():
    """What the other motor wound in counts, less what only stretched the other tendon."""
    a, b = tendon(5.0), loose()
    motor, memory = engaged((a, b), joints=PAIR)
    pulled = (motor[0] + 3e-5, motor[1])
    longer = tendon(5.0, elongation=5e-4 + 1e-5)
    wanted, _ = step(CONFIG, PAIR, memory, (1e-4,), pulled, (longer, b), True, DT)
    assert wanted[1] - motor[1] == pytest.approx(-2e-5)


def test_two_tendons_that_were_tight_when_the_joint_engaged_do_not_go_on_fighting():
    """The plant: tendons of 1e-4 m/N on a joint that nothing holds."""
    compliance = 1e-4
    motor, travel, memory = (0.0, 0.0), 0.0, Control()
    slack = -5.0 * compliance  # both at 5 N where they stand
    for k in range(4000):
        travel += 0.5 * ((motor[0] - travel) - (motor[1] + travel))
        stretch = motor[0] - travel - slack, motor[1] + travel - slack
        seen = [tendon(e / compliance, m, e) for m, e in zip(motor, stretch, strict=True)]
        motor, memory = step(CONFIG, PAIR, memory, (0.0,), motor, seen, True, DT)
        if k == 0:
            assert motor == (0.0, 0.0)
    assert max(e / compliance for e in stretch) < CONFIG.loose_tension + CONFIG.loose_band + 0.2
    assert abs(travel) < 5e-5


def test_joints_do_not_mix():
    joints = (0,), (1, 2), (3,)
    tendons = tendon(5.0), tendon(5.0), loose(), tendon(5.0)
    motor = (0.0,) * 4
    _, memory = step(CONFIG, joints, Control(), (0.0, 0.0, 0.0), motor, tendons, True, DT)
    wanted, _ = step(CONFIG, joints, memory, (1e-5, 2e-5, -3e-5), motor, tendons, True, DT)
    assert wanted == pytest.approx((1e-5, 2e-5, 0.0, -3e-5), abs=1e-12)


anything = st.floats(allow_nan=True, allow_infinity=True)
seen_of_anything = st.builds(
    tendon, anything, anything, st.floats(-1e3, 1e3), st.sampled_from(Status)
)
mostly = st.sampled_from((True, True, True, False))
tick = st.tuples(anything, anything, seen_of_anything, seen_of_anything, anything, mostly)


@settings(max_examples=200)
@given(st.lists(tick, min_size=5, max_size=20))
def test_whatever_comes_in_what_comes_out_is_finite_and_within_the_speed_limit(ticks):
    motor, memory = (0.0, 0.0), Control()
    for command, velocity, a, b, dt, on in ticks:
        was = motor
        motor, memory = step(CONFIG, PAIR, memory, (command,), was, (a, b), on, dt, (velocity,))
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
    assert alone.position == a.displacement - a.elongation


@given(travel=metres, e=st.tuples(st.floats(0.0, 5e-3), st.floats(0.0, 5e-3)))
def test_two_tendons_that_agree_tell_the_travel_of_their_joint_whatever_they_weigh(travel, e):
    start = [tendon(5.0, 2e-4, 2e-4), tendon(5.0, 3e-4, 1e-4)]  # 0 and 2e-4: 1e-4 too much each
    here = [tendon(5.0, travel + e[0], e[0]), tendon(0.1, 2e-4 - travel + e[1], e[1])]
    assert joint_estimate(start, offset(start)).position == pytest.approx(-1e-4, abs=1e-12)
    assert joint_estimate(here, offset(start)).position == pytest.approx(travel - 1e-4, abs=1e-12)


def test_where_tendons_disagree_the_one_with_less_elongation_is_believed_while_it_is_taut():
    def position(b):
        return joint_estimate([tendon(10.0, 1e-3, 1e-3), b]).position  # a says 0

    assert position(loose(1e-5 - 1e-4)) == pytest.approx(1e-4, rel=0.01)  # b says 1e-4
    assert position(loose(1e-5 - 1e-4, tension=0.02)) == 0.0
    refused = tendon(1.0, 1e-5 - 1e-4, 1e-5, Status.INVALID_INPUT)
    assert position(refused) == 0.0
    between = [position(loose(1e-5 - 1e-4, tension=0.05 + 0.001 * k)) for k in range(100)]
    assert all(0.0 <= x <= y for x, y in pairwise(between))


def test_settings_that_cannot_be_are_refused():
    for wrong in (
        {"compensation": 1.0},
        {"compensation": math.nan},
        {"loose_band": 0.5},
        {"loose_tension": 25.0},
        {"tension_max": 0.0},
        {"limit_gain": -1.0},
        {"speed_max": 0.0},
        {"lead": 1.0},
    ):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            ControlConfig(**wrong)
