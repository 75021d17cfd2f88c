import math

import numpy as np
import pytest

from slave.calibration import procedure_state

WINDOW = 2e-4


def fed(travel, tension, direction=1.0):
    line = procedure_state.init_trend(travel[0], tension[0])
    for q, T in zip(travel[1:], tension[1:], strict=True):
        line = procedure_state.update_trend(line, q, T, direction, WINDOW)
    return line


def test_it_is_the_slope_of_what_came_last():
    travel = np.linspace(0.0, 4e-3, 4000)
    tension = np.where(travel < 2e-3, 5.0, 5.0 + 8000.0 * (travel - 2e-3))
    assert procedure_state.compute_stiffness(fed(travel, tension), WINDOW) == pytest.approx(
        8000.0, rel=1e-3
    )
    half = slice(0, 2000)
    assert procedure_state.compute_stiffness(
        fed(travel[half], tension[half]), WINDOW
    ) == pytest.approx(0.0, abs=1e-6)


def test_a_stop_shows_within_a_window_of_travel():
    travel = np.linspace(0.0, 2.2e-3, 2200)
    tension = np.where(travel < 2e-3, 5.0, 5.0 + 8000.0 * (travel - 2e-3))
    assert procedure_state.compute_stiffness(fed(travel, tension), WINDOW) > 2000.0


def test_noise_of_a_poor_cell_is_no_stop():
    travel = np.arange(0.0, 20e-3, 2e-5)  # 20 mm/s at 1 kHz
    tension = 3.0 + 0.05 * np.random.default_rng(3).standard_normal(len(travel))
    line, steepest = procedure_state.init_trend(travel[0], tension[0]), 0.0
    for q, T in zip(travel[1:], tension[1:], strict=True):
        line = procedure_state.update_trend(line, q, T, 1.0, WINDOW)
        stiffness = procedure_state.compute_stiffness(line, WINDOW)
        steepest = max(steepest, stiffness if math.isfinite(stiffness) else 0.0)
    assert steepest < 2000.0


def test_speed_and_rests_do_not_count():
    travel = np.linspace(0.0, 2e-3, 200)
    tension = 4000.0 * travel
    steady = fed(travel, tension)
    resting = fed(np.repeat(travel, 7), np.repeat(tension, 7))
    assert resting == steady


def test_releasing_counts_the_other_way():
    travel = np.linspace(2e-3, 0.0, 200)
    assert procedure_state.compute_stiffness(
        fed(travel, 3000.0 * travel, -1.0), WINDOW
    ) == pytest.approx(3000.0)
    assert math.isinf(procedure_state.compute_stiffness(fed(travel, 3000.0 * travel, 1.0), WINDOW))


def test_too_little_travel_says_nothing():
    travel = np.linspace(0.0, 0.2 * WINDOW, 50)
    assert math.isinf(procedure_state.compute_stiffness(fed(travel, 100.0 * travel), WINDOW))


def test_an_encoder_that_flickers_back_changes_nothing():
    travel = np.linspace(0.0, 1e-3, 500)
    line = fed(travel, 4000.0 * travel)
    assert procedure_state.update_trend(line, travel[-1] - 1e-6, 0.0, 1.0, WINDOW) == line
    assert procedure_state.update_trend(line, travel[-1], 99.0, 1.0, WINDOW) == line
