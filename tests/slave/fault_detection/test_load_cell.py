"""A load cell by itself: stuck and saturated ones are found, those that measure are not."""

import math

import numpy as np
import pytest

from estimator.structs import to_struct
from slave.fault_detection import FaultDetectionConfig
from slave.fault_detection.load_cell import LoadCell, check_cell
from studies.testbed.control_bench import DT
from teleop.session.state_machine import Reason
from tests.slave.fault_detection.readings import readings

CONFIG = FaultDetectionConfig()
SATURATED, STUCK = Reason.CELL_SATURATED, Reason.CELL_STUCK


def judged(values, motor, noise, config=CONFIG):
    """Return the reasons found in a cell's readings [N] while the motor stands at `motor` [m]."""
    cell, limits = LoadCell.new(), to_struct(config)
    pairs = zip(values.tolist(), motor.tolist(), strict=True)
    return np.array([check_cell(limits, noise, cell, T, place, DT) for T, place in pairs])


def total(noise, resolution):
    return math.hypot(noise, resolution / 12**0.5)


N = 4000
AT_REST = np.zeros(N)
TO_AND_FRO = 5e-3 * np.sin(np.arange(N) * DT * 5.0)
RISING = 1.0 + np.arange(N) * 2e-3
CONSTANT = np.full(N, 3.0)
CONSTANT[0] = 2.0  # a cell that has ever shown something else


@pytest.mark.parametrize("tension", [CONSTANT, RISING])
@pytest.mark.parametrize(("noise", "resolution"), [(0.01, 0.002), (0.002, 0.01), (0.0, 0.0)])
def test_a_cell_that_measures_is_never_stuck_moving_or_at_rest(noise, resolution, tension):
    values = readings(tension, noise, resolution)
    for motor in (AT_REST, TO_AND_FRO):
        assert not judged(values, motor, total(noise, resolution)).any()


def test_a_cell_slower_than_the_samples_repeats_itself_without_being_stuck():
    values = np.repeat(readings(RISING[::12], 0.01, 0.002), 12)[:N]
    assert not judged(values, TO_AND_FRO, 0.01).any()


def test_a_cell_less_noisy_than_it_is_said_to_be_is_not_stuck_once_it_has_rested():
    motor = np.concatenate([AT_REST[: N // 2], TO_AND_FRO[: N // 2]])
    values = np.concatenate([CONSTANT[: N // 2], CONSTANT[: N // 4] + 0.002, RISING[: N // 4]])
    assert not judged(values, motor, 0.01).any()


@pytest.mark.parametrize("at", [1000, 2100])
def test_a_stuck_cell_is_found_once_the_motor_moves(at):
    values = readings(3.0 + 0.1 * np.sin(np.arange(N) * 0.003), 0.01, 0.002)
    values[at:] = values[at]
    found = judged(values, TO_AND_FRO, total(0.01, 0.002))
    assert not found[: at + 90].any()
    assert (found[at + 110 :] == STUCK).all()
    assert not judged(values, AT_REST, total(0.01, 0.002)).any()


@pytest.mark.parametrize("resolution", [0.002, 0.1])
def test_where_the_model_has_no_noise_a_load_that_changed_is_not_taken_for_noise(resolution):
    """Rising, swinging, hovering between two steps; then the same for as long while it moves."""
    hovering = 3.0 + 0.1 * np.random.default_rng(3).integers(2, size=N)
    for tension in (RISING, 3.0 + 2.0 * np.sin(np.arange(N) * 0.02), hovering):
        values = readings(np.append(tension, np.full(N, tension[-1])), 0.0, resolution)
        assert not judged(values, np.append(TO_AND_FRO, TO_AND_FRO), 0.0).any()


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_cell_that_has_shown_one_reading_only_is_stuck_once_a_taut_tendons_motor_has_gone_2_mm(
    noise,
):
    motor = np.arange(N) * 5e-6
    found = judged(np.full(N, 3.0), motor, noise)
    assert not found[motor < 2e-3].any()
    assert (found[motor > 2.01e-3] == STUCK).all()
    assert not judged(np.zeros(N), motor, noise).any()  # a slack tendon has no tension at all


def test_a_flat_top_while_the_motor_pulls_is_a_saturated_cell():
    values = np.minimum(readings(RISING, 0.01, 0.002), 5.0)
    motor = np.arange(N) * 5e-6
    found = judged(values, motor, total(0.01, 0.002))
    flat = int(np.argmax(RISING > 5.0))
    assert not found[:flat].any()
    assert (found[flat + 150 :] == SATURATED).all()


def test_a_cell_at_its_range_is_saturated_at_once():
    values = np.minimum(readings(RISING, 0.0, 0.0), 5.0)
    found = judged(values, AT_REST, 0.0, FaultDetectionConfig(cell_range=5.0))
    first = int(np.argmax(found == SATURATED))
    assert RISING[first] == pytest.approx(4.95 + 0.02, abs=0.01)
    assert (found[first:] == SATURATED).all()
