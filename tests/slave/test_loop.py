"""One tick of the slave: commands move it only when engaged and fresh, samples count once."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.law.sheath import Sheath
from estimator.online import online
from estimator.structs import as_bytes
from slave import loop
from slave.config import SlaveConfig, TendonConfig
from slave.gate import GateConfig, GateFlags
from slave.loop_records import NO_POSITION, NO_SAMPLE, NOT_CALIBRATED, EstimatedSample
from slave.rig import RigSample
from slave.samples import _fill_row, estimate, fill_sample
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS, Command
from teleop.session import state_machine
from teleop.session.state_machine import Reason, State
from tests.slave.slave_bench import DT, SlaveBench

CONFIG = SlaveConfig(
    tendons=(TendonConfig(effective_friction=0.8),), gate=GateConfig(displacement_max=0.05)
)
MODELS = [online.TendonModel(Sheath.uniform(0.8, 1.5, 9000.0))]
MODEL = loop.build_rig_model(((0,),), MODELS)
LONG = 3 * round(CONFIG.sample_timeout / DT)  # ticks


def sample(time_s, tension=5.0, displacement=0.01):
    travel = None if displacement is None else np.array([displacement])
    flicker = 1e-9 * (round(time_s / DT) % 7)  # [N] the cell lives
    return RigSample(time_s, np.array([tension + flicker]), travel)


def command(state, position=0.0):
    return Command(state=state, position=(position,) + (0.0,) * (MAX_JOINTS - 1))


def start(starts_at_zero=False):
    return SlaveBench(MODEL, CONFIG, starts_at_zero)


def engaged(displacement=0.01):
    """Return a slave that a master has just engaged, and the time it took."""
    slave, time_s = start(), 0.0
    for state in (State.READY, State.READY, State.ENGAGED):
        slave.tick([sample(time_s, 5.0, displacement)], command(state))
        time_s += DT
    assert slave.state is State.ENGAGED
    return slave, time_s


def coupled(displacements, starts_at_zero=False):
    """Drive a slave whose rig shows `displacements`, then engage it on the last of them.

    The hand is still. Return the motor positions asked for, tick by tick, and the slave.
    """
    slave, asked = start(starts_at_zero), []
    for k, displacement in enumerate(displacements):
        last = k == len(displacements) - 1
        message = command(State.ENGAGED if last else State.READY, 0.004)
        output = slave.tick([sample(k * DT, 5.0, displacement)], message)
        asked.append(output.motor)
    return asked, slave


def test_before_the_first_sample_nothing_is_asked_of_the_motors():
    for starts_at_zero in (False, True):
        slave = start(starts_at_zero)
        output = slave.tick([], command(State.READY))
        assert output.motor == ()
        assert slave.state is State.OFF
        assert slave.memory.readiness == NO_SAMPLE


places = st.floats(-0.2, 0.2)


@settings(deadline=None)  # the first example may compile
@given(st.lists(places, min_size=3, max_size=6), st.booleans())
def test_engaging_asks_the_motors_to_stay_where_their_encoders_say_wherever_that_is(
    displacements, starts_at_zero
):
    asked, slave = coupled(displacements, starts_at_zero)
    assert slave.state is State.ENGAGED
    assert asked[:-1] == [()] * (len(displacements) - 1)
    assert asked[-1][0] == pytest.approx(displacements[-1], abs=1e-15)


def test_motors_that_are_being_enabled_are_held_where_they_are_and_moved_on_from_there():
    slave, time_s = start(), 0.0

    def on(displacement, state, position, motors_follow=False):
        nonlocal time_s
        samples = [] if displacement is None else [sample(time_s, 5.0, displacement)]
        time_s += DT
        return slave.tick(samples, command(state, position), motors_follow=motors_follow).motor

    for _ in range(2):
        assert on(0.01, State.READY, 0.0) == ()
    for k in range(300):  # the hand moves on at 0.02 m/s, and the tendon draws the motor back
        drawn = 0.01 - 1e-6 * k
        assert on(drawn, State.ENGAGED, 2e-5 * k) == pytest.approx((drawn,), abs=1e-15)
    assert on(None, State.ENGAGED, 0.006) == pytest.approx((drawn,), abs=1e-15)
    assert slave.session == (State.ENGAGED, Reason.NONE)
    assert on(drawn, State.ENGAGED, 0.006, motors_follow=True) == pytest.approx((drawn,), abs=1e-15)
    assert on(drawn, State.ENGAGED, 0.006 + 2e-5, motors_follow=True) == pytest.approx(
        (drawn + 2e-5,), abs=1e-9
    )


@pytest.mark.parametrize("reading", [None, math.nan, math.inf])
def test_a_rig_that_does_not_say_where_its_motors_stand_is_never_moved(reading):
    asked, slave = coupled([reading] * 5)
    assert asked == [()] * 5
    assert slave.session == (State.OFF, Reason.NOT_USABLE)
    assert slave.memory.readiness == NO_POSITION


@pytest.mark.parametrize("reading", [None, math.nan])
def test_a_rig_that_starts_at_zero_needs_no_encoder(reading):
    asked, slave = coupled([reading] * 5, starts_at_zero=True)
    assert slave.state is State.ENGAGED
    assert asked[:4] == [()] * 4
    assert asked[4] == pytest.approx((0.0,), abs=1e-15)


def test_a_reading_left_out_is_bridged_but_not_for_long():
    asked, _ = coupled([0.013, 0.014, math.nan])
    assert asked[-1] == pytest.approx((0.014,), abs=1e-15)
    asked, slave = coupled([0.013] + [math.nan] * LONG)
    assert asked[-1] == ()
    assert slave.memory.readiness == NO_POSITION


def test_once_engaged_the_motors_are_held_where_they_were_sent_and_resume_from_there():
    slave, time_s = engaged()
    for k in range(1, 11):
        slave.tick([sample(time_s + k * DT)], command(State.ENGAGED, k * 5e-5))
    sent = slave.motor
    for k, state in enumerate([State.READY] * 4 + [State.ENGAGED] * 2, start=11):
        # the encoder says something else: a motor that sags is not followed
        output = slave.tick([sample(time_s + k * DT, 5.0, 0.0098)], command(state, 0.03))
        assert output.motor == pytest.approx(sent, abs=1e-15)
    assert slave.state is State.ENGAGED


def driven(ticks):
    """Engage and command a steady pull; `ticks` gives the samples of each tick. Return motors."""
    slave, time_s = engaged()
    motors = [slave.motor[0]]
    for k in range(1, len(ticks) + 1):
        tensions = ticks[k - 1]
        samples = [sample(time_s + k * DT, tension) for tension in tensions]
        slave.tick(samples, command(State.ENGAGED, k * 5e-5))
        motors.append(slave.motor[0])
    return np.array(motors), slave


def test_a_tendon_is_pulled_on_between_samples_but_not_blindly():
    at_82_hz = [[5.0] if k % 12 == 0 else [] for k in range(80)]
    motors, _ = driven(at_82_hz)
    assert np.all(np.diff(motors) > 0)
    motors, slave = driven([[]] * 80)
    assert motors[29] > motors[28]
    assert np.all(motors[31:] == motors[31])
    assert slave.state is State.ENGAGED  # not yet a fault


@pytest.mark.parametrize("refused", [math.nan, -3.0])
def test_a_tension_that_the_estimator_refuses_pulls_nothing(refused):
    motors, _ = driven([[refused]] * 20)
    assert np.all(motors == motors[0])


@pytest.mark.parametrize(("tension", "ticks"), [(31.0, 22), (31.0, 18), (29.0, 100)])
def test_a_tension_far_over_its_limit_is_a_fault_if_it_lasts(tension, ticks):
    assert CONFIG.gate.tension_max == 25.0
    motors, slave = driven([[tension]] * ticks)
    assert np.all(np.diff(motors) <= 0.0)  # paid out if anything
    over = (tension, ticks) == (31.0, 22)
    expected = (State.FAULT, Reason.OVER_LIMIT) if over else (State.ENGAGED, Reason.NONE)
    assert slave.session == expected


def test_a_rig_without_a_calibration_that_fits_it_is_never_engaged_and_says_why():
    uncalibrated = loop.build_rig_model(((0,),), MODELS, "no calibration")
    slave = SlaveBench(uncalibrated, CONFIG, True)
    for k, state in enumerate([State.READY] * 3 + [State.ENGAGED] * 20):
        output = slave.tick([sample(k * DT)], command(state, 1e-3))
        assert output.motor == ()
        assert slave.session == (State.OFF, Reason.NOT_USABLE)
    assert slave.memory.readiness == NOT_CALIBRATED


def test_a_broken_tendon_is_a_fault_that_names_it_and_holds_the_motors():
    slave, reeled = start(True), 0.0
    for k in range(3):
        slave.tick([sample(k * DT)], command(State.READY))
    for k in range(3, 1200):  # wound in by 30 mm, and no tension
        held, reeled = slave.motor, (k - 3) * 2.5e-5
        now = sample(k * DT, 0.0, 0.01 + reeled)
        slave.tick([now], command(State.ENGAGED, reeled))
        if slave.state is State.FAULT:
            break
    assert slave.session == (State.FAULT, Reason.TENDON_BROKEN)
    assert slave.memory.faulty_tendon == 0
    assert slave.motor == held
    assert CONFIG.fault_detection.take_up <= reeled < CONFIG.fault_detection.take_up + 0.002


def test_samples_from_before_the_loop_tell_where_the_tendon_and_the_motor_are():
    before = [sample(k * DT, 10.0 * math.sin(0.01 * k) + 1e-6, 0.02) for k in range(300)]
    slave = SlaveBench(MODEL, CONFIG, True, before)
    newest = slave.memory.tendons[0]
    assert slave.memory.sample_time == before[-1].time_s
    assert newest.tension == before[-1].proximal_tension[0]
    assert newest.estimate.distal_tension > 0.1
    slave.tick([sample(0.3)], command(State.READY))
    slave.tick([sample(0.301, 5.0, 0.02)], command(State.READY))
    output = slave.tick([sample(0.302, 5.0, 0.02)], command(State.ENGAGED))
    assert output.motor == pytest.approx((0.02,), abs=1e-15)


def test_peaks_that_pass_do_not_add_up_to_an_overload():
    _, slave = driven(([[31.0]] * 15 + [[5.0]]) * 10)
    assert slave.state is State.ENGAGED


def test_a_tension_far_over_its_limit_is_no_fault_while_nobody_is_engaged():
    slave = start()
    for k in range(50):
        slave.tick([sample(k * DT, 31.0)], command(State.READY))
    assert slave.state is State.READY


@pytest.mark.parametrize("position", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_no_number_is_a_fault_and_moves_nothing(position):
    slave, time_s = engaged()
    held = slave.motor
    output = slave.tick([sample(time_s)], command(State.ENGAGED, position))
    assert slave.session == (State.FAULT, Reason.NOT_FINITE)
    assert output.motor == held
    idle = start()
    idle.tick([sample(0.0)], command(State.READY, position))
    assert idle.state is State.READY  # nobody asks to be there


def test_engaging_on_a_command_that_is_no_number_does_not_spoil_what_follows():
    slave = start()
    for k, (state, position) in enumerate(
        [(State.READY, 0.0), (State.READY, 0.0), (State.ENGAGED, math.nan), (State.READY, 0.0)]
        + [(State.ENGAGED, 0.001)] * 3
    ):
        output = slave.tick([sample(k * DT)], command(state, position))
    assert slave.state is State.ENGAGED
    assert output.motor == pytest.approx((0.01,), abs=1e-12)


def test_silence_is_held_and_a_tension_over_its_limit_is_given_way_to():
    slave, time_s = engaged()
    (start,) = slave.motor
    for k in range(100):
        tight = 30.0 if 40 <= k < 60 else 5.0
        output = slave.tick(
            [sample(time_s + k * DT, tight)], command(State.ENGAGED, 0.01), fresh=False
        )
        assert slave.session == (State.HOLDING, Reason.PEER_SILENT)
        if k < 40:
            assert output.motor == (start,)
    give = CONFIG.gate.yield_gain * (30.0 - CONFIG.gate.tension_max) * 20 * DT
    assert output.motor[0] == pytest.approx(start - give, rel=1e-6)


def test_while_clutched_the_motor_holds_and_resumes_without_a_jump():
    slave, time_s = engaged()
    held = slave.motor
    for k, state in enumerate([State.CLUTCHED] * 50 + [State.ENGAGED] * 50):
        output = slave.tick([sample(time_s + k * DT)], command(state))
        assert output.motor == pytest.approx(held, abs=1e-12)
        assert slave.state is state


@pytest.mark.parametrize("why", ["stale", "released", "fault", "silent"])
def test_the_motor_holds_as_soon_as(why):
    slave, time_s = engaged()
    held = slave.motor
    for k in range(200):
        output = slave.tick(
            [] if why == "silent" else [sample(time_s + k * DT)],
            command(State.READY if why == "released" else State.ENGAGED, 0.02 if k > 110 else 0.0),
            fresh=why != "stale",
            fault=Reason.RIG_FAULT if why == "fault" else Reason.NONE,
        )
        assert output.motor == pytest.approx(held, abs=1e-12)
    assert slave.state is not State.ENGAGED
    if why == "silent":
        assert slave.session.reason is Reason.SAMPLES_STALE


def test_each_sample_is_estimated_once_whatever_the_ticks_do():
    tensions = 5.0 + 3.0 * np.sin(np.linspace(0.0, 20.0, 300))
    samples = [sample(k * DT, t, 1e-4 * t) for k, t in enumerate(tensions)]
    slave = start()
    one_by_one = np.concatenate([slave.tick([row]).rows for row in samples])
    bunched, slave, k = [], start(), 0
    for size in [0, 3, 1, 0, 7, 89, 200]:
        bunched.append(slave.tick(samples[k : k + size]).rows)
        k += size
    bunched = np.concatenate(bunched)
    assert len(bunched) == len(one_by_one) == 300
    for name in bunched["tendons"]["estimate"].dtype.names:
        both = (rows["tendons"]["estimate"][name][:, 0] for rows in (bunched, one_by_one))
        np.testing.assert_array_equal(*both)


def test_the_answer_says_what_the_tick_found():
    slave = start()
    before = slave.tick([], command(State.READY)).state
    assert (before.joints, before.sample_age_ns, before.echo_stamp_ns) == (0, 0, 0)
    assert not any((*before.position, *before.force, *before.energy, *before.wave, *before.status))
    for k, state in enumerate((State.READY, State.READY, State.ENGAGED)):
        told = replace(command(state), sender=3, stamp_ns=1000 + k)
        answer = slave.tick([sample(k * DT, 5.0)], told).state
    joint = slave.memory.joints[0]
    assert (answer.state, answer.reason) == slave.session == (State.ENGAGED, Reason.NONE)
    assert (answer.joints, answer.sample_age_ns, answer.echo_stamp_ns) == (1, 0, 1002)
    assert answer.coupling == loop.DIRECT.signature
    assert answer.force[0] == joint.force > 0.0
    assert answer.force_low[0] == joint.low < answer.force[0] < joint.high == answer.force_high[0]
    assert answer.position[0] == joint.position
    assert not any((*answer.position[1:], *answer.force[1:], *answer.force_high[1:]))
    silent = slave.tick([], told).state
    assert silent.sample_age_ns == DT * 1e9
    assert silent.force == answer.force


def test_a_sample_without_encoders_keeps_nothing_of_the_row_before():
    rows = EstimatedSample.array()
    full = RigSample(0.0, *(np.array([number]) for number in (1.0, 2.0, 3.0, 4.0)))
    fill_sample(rows, 0, full)
    fill_sample(rows, 0, sample(0.001, 5.0, None))
    row = rows[0]
    assert not row["has_displacement"]
    gone = row["tendons"]["displacement"], row["bench_tension"], row["bench_displacement"]
    assert all(math.isnan(column[0]) for column in gone)


@pytest.mark.parametrize("short", [0, 1])
def test_a_sample_of_too_few_or_too_many_tendons_is_no_reading_of_what_is_in_memory(short):
    rows = EstimatedSample.array(2)
    before = as_bytes(rows[1:]).copy()
    many = np.arange(float(2 * MAX_TENDONS))
    few = many[:short]
    fill_sample(rows, 0, RigSample(0.0, many, few, few, few))
    row = rows[0]
    assert row["tendons"]["tension"].tolist() == many[:MAX_TENDONS].tolist()
    for column in (row["tendons"]["displacement"], row["bench_tension"], row["bench_displacement"]):
        assert column[:short].tolist() == few.tolist()
        assert np.isnan(column[short:]).all()
    assert (as_bytes(rows[1:]) == before).all()


def test_a_sample_that_lacks_a_tendon_is_silence_and_not_the_one_before():
    slave = SlaveBench(loop.build_rig_model(JOINT_AND_PAIR, MODELS * 3), CONFIG, True)
    rows = EstimatedSample.array()
    for k, tendons in enumerate((3, 3, 2)):
        fill_sample(rows, 0, RigSample(k * DT, np.full(tendons, 5.0), np.zeros(tendons)))
        estimate(*slave.slave.estimate_arguments, rows, 1)
    assert rows["tendons"]["valid"][0, :3].tolist() == [True, True, False]


JOINT_AND_PAIR = ((0,), (1, 2))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2), st.lists(st.floats(0.0, 20.0), min_size=3, max_size=20))
def test_what_happens_to_a_tendon_is_not_seen_in_another_ones_estimate(which, tensions):
    model = loop.build_rig_model(JOINT_AND_PAIR, MODELS * 3)

    def drive(varied):
        slave = SlaveBench(model, CONFIG, True)
        for k, tension in enumerate(tensions):
            now = np.array([5.0 + 0.01 * k] * 3)
            now[which] = tension if varied else now[which]
            rows = slave.tick([RigSample(k * DT, now, np.full(3, 1e-4 * k))]).rows
        return rows["tendons"][0]

    here, there = drive(True), drive(False)
    for name in ("distal_tension", "low", "high", "elongation", "front", "status"):
        for i in {0, 1, 2} - {which}:
            np.testing.assert_equal(here["estimate"][name][i], there["estimate"][name][i])


anything = st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=60, deadline=None)
@given(
    places,
    st.lists(
        st.tuples(anything, anything, anything, st.sampled_from(State), st.booleans()), max_size=40
    ),
)
def test_whatever_comes_in_the_motors_stay_within_their_limits(displacement, ticks):
    limits = CONFIG.gate
    slave, time_s = engaged(displacement)
    lowest, highest = (
        min(limits.displacement_min, displacement),
        max(limits.displacement_max, displacement),
    )
    for k, (tension, reading, position, state, fresh) in enumerate(ticks):
        was = slave.motor[0]
        samples = [sample(time_s + k * DT, tension, reading)]
        output = slave.tick(samples, command(state, position), fresh)
        assert math.isfinite(output.motor[0])
        assert lowest - 1e-15 <= output.motor[0] <= highest + 1e-15
        assert abs(output.motor[0] - was) <= limits.speed_max * DT * (1 + 1e-9)
        if not (fresh and state == State.ENGAGED):
            assert GateFlags.HELD in output.verdict
            if output.motor[0] != was:  # too tight
                assert output.verdict == GateFlags.HELD | GateFlags.YIELDED
                assert output.motor[0] < was
                assert tension >= limits.tension_max
                assert state_machine.may_yield(slave.memory.session)


def test_arrays_of_any_kind_are_taken_without_compiling_anew():
    rows = EstimatedSample.array()
    numbers = np.array([1.5, 2.5])
    read_only = numbers.copy()
    read_only.flags.writeable = False
    kinds = [numbers, np.repeat(numbers, 3)[::3], read_only, numbers.astype(np.float32)]
    fill_sample(rows, 0, RigSample(0.0, numbers, numbers))
    compiled_before = len(_fill_row.signatures)
    for kind in kinds:
        fill_sample(rows, 0, RigSample(1, kind, kind, kind, kind))
        assert rows["tendons"]["tension"][0, :2].tolist() == [1.5, 2.5]
        assert rows["bench_displacement"][0, :2].tolist() == [1.5, 2.5]
    assert len(_fill_row.signatures) == compiled_before
