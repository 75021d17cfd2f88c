"""One tick of the slave: commands move it only when engaged and fresh, samples count once."""

import math

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
from teleop.session import Reason, State

CONFIG = SlaveConfig(
    tendons=(TendonConfig(effective_friction=0.8),), gate=GateConfig(displacement_max=0.05)
)
PREPARED = [online.prepare(online.TendonModel(Sheath.uniform(0.8, 1.5, 9000.0)))]
DT = 0.001


def sample(time_s, tension=5.0, displacement=0.01):
    return RigSample(time_s, np.array([tension]), np.array([displacement]))


def command(state, position=0.0):
    return Command(state=state, position=(position,) + (0.0,) * (MAX_JOINTS - 1))


def tick(memory, samples=(), message=None, fresh=True, fault=Reason.NONE):
    return loop.step(PREPARED, CONFIG, memory, samples, message, fresh, fault, DT)


def engaged():
    """Return the memory of a slave that a master has just engaged, and the time it took."""
    memory, time_s = loop.start(PREPARED), 0.0
    for state in (State.READY, State.READY, State.ENGAGED):
        _, memory = tick(memory, [sample(time_s)], command(state))
        time_s += DT
    assert memory.session.state == State.ENGAGED
    return memory, time_s


def test_before_the_first_sample_nothing_is_asked_of_the_motors():
    output, memory = tick(loop.start(PREPARED), [], command(State.READY))
    assert output.motor == ()
    assert memory.session.state == State.OFF


def test_the_motors_start_where_the_encoders_say():
    output, _ = tick(loop.start(PREPARED), [sample(0.0, displacement=0.013)])
    assert output.motor == (0.013,)


def test_engaged_the_motor_follows_the_commanded_travel():
    memory, time_s = engaged()
    start = memory.motor[0]
    for k in range(1, 51):
        message = command(State.ENGAGED, position=k * 5e-5)
        _, memory = tick(memory, [sample(time_s + k * DT)], message)
    assert memory.motor[0] == pytest.approx(start + 50 * 5e-5)


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
        assert output.motor == held
    assert memory.session.state != State.ENGAGED
    if why == "silent":
        assert memory.session.reason == Reason.SAMPLES_STALE


def test_samples_that_cannot_be_used_are_silence():
    memory, time_s = engaged()
    for k in range(200):
        _, memory = tick(memory, [sample(time_s + k * DT, math.nan)], command(State.ENGAGED))
    assert memory.session.state == State.FAULT


def test_each_sample_is_estimated_once_whatever_the_ticks_do():
    tensions = 5.0 + 3.0 * np.sin(np.linspace(0.0, 20.0, 300))
    samples = [sample(k * DT, t, 1e-4 * t) for k, t in enumerate(tensions)]
    one_by_one, memory = [], loop.start(PREPARED)
    for row in samples:
        output, memory = tick(memory, [row])
        one_by_one += output.rows
    bunched, memory, k = [], loop.start(PREPARED), 0
    for size in [0, 3, 1, 0, 7, 89, 200]:
        output, memory = tick(memory, samples[k : k + size])
        bunched += output.rows
        k += size
    assert [r.estimates for r in bunched] == [r.estimates for r in one_by_one]


anything = st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(anything, anything, anything, st.sampled_from(State), st.booleans()), max_size=40
    )
)
def test_whatever_comes_in_the_motors_stay_within_their_limits(ticks):
    limits = CONFIG.gate
    memory = loop.start(PREPARED)
    output, memory = tick(memory, [sample(0.0)], command(State.READY))
    for k, (tension, displacement, position, state, fresh) in enumerate(ticks, start=1):
        was = output.motor[0]
        output, memory = tick(
            memory, [sample(k * DT, tension, displacement)], command(state, position), fresh
        )
        assert math.isfinite(output.motor[0])
        assert limits.displacement_min <= output.motor[0] <= limits.displacement_max
        assert abs(output.motor[0] - was) <= limits.speed_max * DT * (1 + 1e-9)
        if not (fresh and state == State.ENGAGED):
            assert output.verdict == Verdict.HELD
            assert output.motor[0] == was
