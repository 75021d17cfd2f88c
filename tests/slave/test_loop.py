"""One tick of the slave: commands move it only when engaged and fresh, samples count once."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator import online
from estimator.sheath import Sheath
from slave import loop
from slave.config import SlaveConfig, TendonConfig
from slave.gate import GateConfig, Verdict
from slave.rig import RigSample
from teleop.messages import MAX_JOINTS, Command
from teleop.session import Reason, Session, State

CONFIG = SlaveConfig(
    tendons=(TendonConfig(effective_friction=0.8),), gate=GateConfig(displacement_max=0.05)
)
KNOWN = loop.know(((0,),), [online.TendonModel(Sheath.uniform(0.8, 1.5, 9000.0))])
DT = 0.001


LONG = 3 * round(CONFIG.sample_timeout / DT)  # ticks


def sample(time_s, tension=5.0, displacement=0.01):
    travel = None if displacement is None else np.array([displacement])
    flicker = 1e-9 * (round(time_s / DT) % 7)  # [N] the cell lives
    return RigSample(time_s, np.array([tension + flicker]), travel)


def command(state, position=0.0):
    return Command(state=state, position=(position,) + (0.0,) * (MAX_JOINTS - 1))


def start(starts_at_zero=False):
    return loop.start(KNOWN, starts_at_zero)


def tick(memory, samples=(), message=None, fresh=True, fault=Reason.NONE):
    return loop.step(KNOWN, CONFIG, memory, samples, message, fresh, fault, DT)


def engaged(displacement=0.01):
    """Return the memory of a slave that a master has just engaged, and the time it took."""
    memory, time_s = start(), 0.0
    for state in (State.READY, State.READY, State.ENGAGED):
        _, memory = tick(memory, [sample(time_s, 5.0, displacement)], command(state))
        time_s += DT
    assert memory.session.state == State.ENGAGED
    return memory, time_s


def coupled(displacements, starts_at_zero=False):
    """Drive a slave whose rig shows `displacements`, then engage it on the last of them.

    The hand is still. Return the motor positions asked for, tick by tick, and the memory.
    """
    memory, asked = start(starts_at_zero), []
    for k, displacement in enumerate(displacements):
        last = k == len(displacements) - 1
        message = command(State.ENGAGED if last else State.READY, 0.004)
        output, memory = tick(memory, [sample(k * DT, 5.0, displacement)], message)
        asked.append(output.motor)
    return asked, memory


def test_before_the_first_sample_nothing_is_asked_of_the_motors():
    for starts_at_zero in (False, True):
        output, memory = tick(start(starts_at_zero), [], command(State.READY))
        assert output.motor == ()
        assert memory.session.state == State.OFF
        assert memory.hindrance == loop.NO_SAMPLE


places = st.floats(-0.2, 0.2)


@settings(deadline=None)  # the first example may compile
@given(st.lists(places, min_size=3, max_size=6), st.booleans())
def test_engaging_asks_the_motors_to_stay_where_their_encoders_say_wherever_that_is(
    displacements, starts_at_zero
):
    asked, memory = coupled(displacements, starts_at_zero)
    assert memory.session.state == State.ENGAGED
    assert asked[:-1] == [()] * (len(displacements) - 1)
    assert asked[-1][0] == pytest.approx(displacements[-1], abs=1e-15)


@pytest.mark.parametrize("reading", [None, math.nan, math.inf])
def test_a_rig_that_does_not_say_where_its_motors_stand_is_never_moved(reading):
    asked, memory = coupled([reading] * 5)
    assert asked == [()] * 5
    assert memory.session == Session(State.OFF, Reason.NOT_USABLE)
    assert memory.hindrance == loop.NO_POSITION


@pytest.mark.parametrize("reading", [None, math.nan])
def test_a_rig_that_starts_at_zero_needs_no_encoder(reading):
    asked, memory = coupled([reading] * 5, starts_at_zero=True)
    assert memory.session.state == State.ENGAGED
    assert asked[:4] == [()] * 4
    assert asked[4] == pytest.approx((0.0,), abs=1e-15)


def test_a_reading_left_out_is_bridged_but_not_for_long():
    asked, _ = coupled([0.013, 0.014, math.nan])
    assert asked[-1] == pytest.approx((0.014,), abs=1e-15)
    asked, memory = coupled([0.013] + [math.nan] * LONG)
    assert asked[-1] == ()
    assert memory.hindrance == loop.NO_POSITION


def test_once_engaged_the_motors_are_held_where_they_were_sent_and_resume_from_there():
    memory, time_s = engaged()
    for k in range(1, 11):
        _, memory = tick(memory, [sample(time_s + k * DT)], command(State.ENGAGED, k * 5e-5))
    sent = memory.motor
    for k, state in enumerate([State.READY] * 4 + [State.ENGAGED] * 2, start=11):
        # the encoder says something else: a motor that sags is not followed
        output, memory = tick(memory, [sample(time_s + k * DT, 5.0, 0.0098)], command(state, 0.03))
        assert output.motor == pytest.approx(sent, abs=1e-15)
    assert memory.session.state == State.ENGAGED


def test_engaged_the_motor_follows_the_commanded_travel():
    memory, time_s = engaged()
    begin = memory.motor[0]
    for k in range(1, 51):
        message = command(State.ENGAGED, position=k * 5e-5)
        _, memory = tick(memory, [sample(time_s + k * DT)], message)
    assert memory.motor[0] == pytest.approx(begin + 50 * 5e-5)


def driven(ticks):
    """Engage and command a steady pull; `ticks` gives the samples of each tick. Return motors."""
    memory, time_s = engaged()
    motors = [memory.motor[0]]
    for k in range(1, len(ticks) + 1):
        tensions = ticks[k - 1]
        samples = [sample(time_s + k * DT, tension) for tension in tensions]
        _, memory = tick(memory, samples, command(State.ENGAGED, k * 5e-5))
        motors.append(memory.motor[0])
    return np.array(motors), memory


def test_a_tendon_is_pulled_on_between_samples_but_not_blindly():
    at_82_hz = [[5.0] if k % 12 == 0 else [] for k in range(80)]
    motors, _ = driven(at_82_hz)
    assert np.all(np.diff(motors) > 0)
    motors, memory = driven([[]] * 80)
    assert motors[29] > motors[28]
    assert np.all(motors[31:] == motors[31])
    assert memory.session.state == State.ENGAGED  # not yet a fault


@pytest.mark.parametrize("refused", [math.nan, -3.0])
def test_a_tension_that_the_estimator_refuses_pulls_nothing(refused):
    motors, _ = driven([[refused]] * 20)
    assert np.all(motors == motors[0])


@pytest.mark.parametrize(("tension", "ticks"), [(31.0, 22), (31.0, 18), (29.0, 100)])
def test_a_tension_far_over_its_limit_is_a_fault_if_it_lasts(tension, ticks):
    assert CONFIG.gate.tension_max == 25.0
    motors, memory = driven([[tension]] * ticks)
    assert np.all(np.diff(motors) <= 0.0)  # paid out if anything
    over = (tension, ticks) == (31.0, 22)
    expected = (State.FAULT, Reason.OVER_LIMIT) if over else (State.ENGAGED, Reason.NONE)
    assert (memory.session.state, memory.session.reason) == expected


def test_a_rig_without_a_calibration_that_fits_it_is_never_engaged_and_says_why():
    barred = KNOWN._replace(barred="no calibration")
    memory = loop.start(barred, True)
    for k, state in enumerate([State.READY] * 3 + [State.ENGAGED] * 20):
        output, memory = loop.step(
            barred, CONFIG, memory, [sample(k * DT)], command(state, 1e-3), True, Reason.NONE, DT
        )
        assert output.motor == ()
        assert memory.session == Session(State.OFF, Reason.NOT_USABLE)
    assert memory.hindrance == "no calibration"


def test_a_broken_tendon_is_a_fault_that_names_it_and_holds_the_motors():
    memory, reeled = start(True), 0.0
    for k in range(3):
        _, memory = tick(memory, [sample(k * DT)], command(State.READY))
    for k in range(3, 1200):  # wound in by 30 mm, and no tension
        held, reeled = memory.motor, (k - 3) * 2.5e-5
        now = sample(k * DT, 0.0, 0.01 + reeled)
        _, memory = tick(memory, [now], command(State.ENGAGED, reeled))
        if memory.session.state == State.FAULT:
            break
    assert memory.session == Session(State.FAULT, Reason.TENDON_BROKEN)
    assert memory.found.tendon == 0
    assert memory.motor == held
    assert CONFIG.fault_detection.take_up <= reeled < CONFIG.fault_detection.take_up + 0.002


def test_samples_from_before_the_loop_tell_where_the_tendon_and_the_motor_are():
    before = [sample(k * DT, 10.0 * math.sin(0.01 * k) + 1e-6, 0.02) for k in range(300)]
    memory = loop.start(KNOWN, True, before)
    assert memory.newest.sample is before[-1]
    assert memory.newest.estimates[0].distal_tension > 0.1
    _, memory = tick(memory, [sample(0.3)], command(State.READY))
    _, memory = tick(memory, [sample(0.301, 5.0, 0.02)], command(State.READY))
    output, memory = tick(memory, [sample(0.302, 5.0, 0.02)], command(State.ENGAGED))
    assert output.motor == pytest.approx((0.02,), abs=1e-15)


def test_peaks_that_pass_do_not_add_up_to_an_overload():
    _, memory = driven(([[31.0]] * 15 + [[5.0]]) * 10)
    assert memory.session.state == State.ENGAGED


def test_a_tension_far_over_its_limit_is_no_fault_while_nobody_is_engaged():
    memory = start()
    for k in range(50):
        _, memory = tick(memory, [sample(k * DT, 31.0)], command(State.READY))
    assert memory.session.state == State.READY


@pytest.mark.parametrize("position", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_no_number_is_a_fault_and_moves_nothing(position):
    memory, time_s = engaged()
    held = memory.motor
    output, memory = tick(memory, [sample(time_s)], command(State.ENGAGED, position))
    assert memory.session == Session(State.FAULT, Reason.NOT_FINITE)
    assert output.motor == held
    _, idle = tick(start(), [sample(0.0)], command(State.READY, position))
    assert idle.session.state == State.READY  # nobody asks to be there


def test_engaging_on_a_command_that_is_no_number_does_not_spoil_what_follows():
    memory = start()
    for k, (state, position) in enumerate(
        [(State.READY, 0.0), (State.READY, 0.0), (State.ENGAGED, math.nan), (State.READY, 0.0)]
        + [(State.ENGAGED, 0.001)] * 3
    ):
        output, memory = tick(memory, [sample(k * DT)], command(state, position))
    assert memory.session.state == State.ENGAGED
    assert output.motor == pytest.approx((0.01,), abs=1e-12)


def test_silence_is_held_and_a_tension_over_its_limit_is_given_way_to():
    memory, time_s = engaged()
    (start,) = memory.motor
    for k in range(100):
        tight = 30.0 if 40 <= k < 60 else 5.0
        output, memory = tick(
            memory, [sample(time_s + k * DT, tight)], command(State.ENGAGED, 0.01), fresh=False
        )
        assert memory.session == Session(State.HOLDING, Reason.PEER_SILENT)
        if k < 40:
            assert output.motor == (start,)
    give = CONFIG.gate.yield_gain * (30.0 - CONFIG.gate.tension_max) * 20 * DT
    assert output.motor[0] == pytest.approx(start - give, rel=1e-6)


def test_while_clutched_the_motor_holds_and_resumes_without_a_jump():
    memory, time_s = engaged()
    held = memory.motor
    for k, state in enumerate([State.CLUTCHED] * 50 + [State.ENGAGED] * 50):
        output, memory = tick(memory, [sample(time_s + k * DT)], command(state))
        assert output.motor == pytest.approx(held, abs=1e-12)
        assert memory.session.state == state


def test_a_stop_drops_what_was_commanded_for_good():
    memory, time_s = engaged()
    for k in range(300):
        _, memory = loop.step(
            KNOWN,
            CONFIG,
            memory,
            [sample(time_s + k * DT)],
            command(State.READY if k > 250 else State.ENGAGED, 0.01),
            True,
            Reason.NONE,
            DT,
            stop=Reason.STOP_CALLED if k == 20 else Reason.NONE,
            reset=k == 150,
        )
        if k == 20:
            held = memory.motor
        if 20 <= k < 150:
            assert memory.session == Session(State.STOPPED, Reason.STOP_CALLED)
        if k >= 20:
            assert memory.motor == held
    assert memory.session.state == State.READY


def test_a_master_that_was_restarted_is_not_followed():
    memory, time_s = engaged()
    held = memory.motor
    for k in range(50):
        other = replace(command(State.ENGAGED, 0.01), sender=9)
        output, memory = tick(memory, [sample(time_s + k * DT)], other)
        assert output.motor == held
        assert memory.session == Session(State.FAULT, Reason.PEER_RESTARTED)


@pytest.mark.parametrize("why", ["stale", "released", "fault", "silent"])
def test_the_motor_holds_as_soon_as(why):
    memory, time_s = engaged()
    held = memory.motor
    for k in range(200):
        output, memory = tick(
            memory,
            [] if why == "silent" else [sample(time_s + k * DT)],
            command(State.READY if why == "released" else State.ENGAGED, 0.02 if k > 110 else 0.0),
            fresh=why != "stale",
            fault=Reason.RIG_FAULT if why == "fault" else Reason.NONE,
        )
        assert output.motor == pytest.approx(held, abs=1e-12)
    assert memory.session.state != State.ENGAGED
    if why == "silent":
        assert memory.session.reason == Reason.SAMPLES_STALE


def test_a_fault_lasts_until_the_operator_lets_go_which_a_master_at_fault_has_not_seen():
    memory, time_s = engaged()
    _, memory = tick(memory, [sample(time_s)], command(State.ENGAGED), fault=Reason.OVER_LIMIT)
    for state in (State.ENGAGED, State.FAULT, State.FAULT):
        _, memory = tick(memory, [sample(time_s)], command(state))
        assert memory.session == Session(State.FAULT, Reason.OVER_LIMIT)
    _, memory = tick(memory, [sample(time_s)], command(State.READY))
    assert memory.session.state == State.READY


def test_samples_that_cannot_be_used_are_silence():
    memory, time_s = engaged()
    for k in range(200):
        _, memory = tick(memory, [sample(time_s + k * DT, math.nan)], command(State.ENGAGED))
    assert memory.session.state == State.FAULT


def test_each_sample_is_estimated_once_whatever_the_ticks_do():
    tensions = 5.0 + 3.0 * np.sin(np.linspace(0.0, 20.0, 300))
    samples = [sample(k * DT, t, 1e-4 * t) for k, t in enumerate(tensions)]
    one_by_one, memory = [], start()
    for row in samples:
        output, memory = tick(memory, [row])
        one_by_one += output.rows
    bunched, memory, k = [], start(), 0
    for size in [0, 3, 1, 0, 7, 89, 200]:
        output, memory = tick(memory, samples[k : k + size])
        bunched += output.rows
        k += size
    assert [r.estimates for r in bunched] == [r.estimates for r in one_by_one]


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
    memory, time_s = engaged(displacement)
    lowest, highest = (
        min(limits.displacement_min, displacement),
        max(limits.displacement_max, displacement),
    )
    for k, (tension, reading, position, state, fresh) in enumerate(ticks):
        was = memory.motor[0]
        samples = [sample(time_s + k * DT, tension, reading)]
        output, memory = tick(memory, samples, command(state, position), fresh)
        assert math.isfinite(output.motor[0])
        assert lowest - 1e-15 <= output.motor[0] <= highest + 1e-15
        assert abs(output.motor[0] - was) <= limits.speed_max * DT * (1 + 1e-9)
        if not (fresh and state == State.ENGAGED):
            assert Verdict.HELD in output.verdict
            if output.motor[0] != was:  # too tight
                assert output.verdict == Verdict.HELD | Verdict.YIELDED
                assert output.motor[0] < was
                assert tension >= limits.tension_max
                assert memory.session.may_yield
