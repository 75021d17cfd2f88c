"""Motors that do not go where they are sent, and samples that do not go with them."""

import math

import numpy as np
import pytest

from estimator.structs import to_struct
from slave.fault_detection import (
    FaultDetectionConfig,
    MotorChecks,
    check_motors,
    record_motor_readings,
)
from slave.rig_layout import EstimatedTendon, build_rig_layout
from studies.testbed.control_bench import DT
from teleop.session.state_machine import Reason

SETTINGS = FaultDetectionConfig()
CONFIG = to_struct(SETTINGS)
LAYOUT = build_rig_layout(((0, 1), (2,)))[0]
NOTHING = Reason.NONE, -1


def tick(motors, frames, sent, has_sent=True):
    """Take frames of (tensions, displacements) and check; return what is found."""
    places = np.full(16, math.nan)
    places[:3] = sent
    for tension, displacement in frames:
        tendons = EstimatedTendon.array(16)
        tendons["tension"][:3], tendons["displacement"][:3] = tension, displacement
        record_motor_readings(motors, LAYOUT, tendons, places)
    return check_motors(CONFIG, motors, LAYOUT, places, has_sent, bool(frames), DT)


def frame(k, displacement=0.0):
    return [(1.0 + 1e-3 * k, displacement)]


def test_a_motor_that_lags_for_long_is_a_fault_and_the_furthest_is_named():
    motors, found = MotorChecks.new(), []
    for k in range(300):
        behind = np.array([0.5, 1.1, 2.0]) * SETTINGS.motor_lag if k >= 100 else np.zeros(3)
        found.append(tick(motors, frame(k, -behind), np.zeros(3)))
    late = round(SETTINGS.motor_lag_time / DT)
    assert set(found[: 100 + late - 1]) == {NOTHING}
    assert set(found[100 + late + 1 :]) == {(Reason.MOTOR_POSITION_ERROR, 2)}
    assert tick(motors, frame(300), np.zeros(3)) == NOTHING  # it has arrived
    assert motors.late == 0.0


def test_time_counts_also_in_ticks_without_a_sample():
    motors = MotorChecks.new()
    tick(motors, frame(0, 2.0 * SETTINGS.motor_lag), np.zeros(3))
    found = [tick(motors, [], np.zeros(3)) for _ in range(200)]
    assert found[-1] == (Reason.MOTOR_POSITION_ERROR, 0)


@pytest.mark.parametrize("alike", [0, 1, 2])
def test_a_frame_is_repeated_once_its_motor_was_sent_on(alike):
    motors = MotorChecks.new()
    for k in range(100):
        sent = 1e-5 * k
        tension = np.full(3, 1.0 + 1e-3 * k)
        tension[alike] = 1.0
        tick(motors, [(tension, 0.0)], np.full(3, sent))
        assert bool(motors.repeated) == (sent > SETTINGS.stuck_travel)
    tick(motors, frame(100), np.full(3, sent))
    assert not motors.repeated


def test_a_tendon_without_an_encoder_is_never_repeated_nor_off_its_position():
    motors = MotorChecks.new()
    for k in range(300):
        assert tick(motors, [(1.0, math.nan)], np.full(3, 1e-3 * k)) == NOTHING
        assert not motors.repeated


def test_what_was_before_motors_were_sent_anywhere_is_forgotten():
    motors = MotorChecks.new()
    far = np.full(3, 2.0 * SETTINGS.stuck_travel)
    tick(motors, frame(0), np.zeros(3))
    tick(motors, frame(0), far)
    assert motors.repeated
    assert tick(motors, frame(0), np.zeros(3), has_sent=False) == NOTHING
    assert (bool(motors.repeated), bool(motors.has_readings), motors.late) == (False, False, 0.0)
    tick(motors, frame(0), far)  # the same frame again, but known from now on only
    assert not motors.repeated
    assert motors.readings[0].sent == far[0]
