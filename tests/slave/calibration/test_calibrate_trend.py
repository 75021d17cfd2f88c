import math

import numpy as np

from slave.calibration import procedure_state

WINDOW = 2e-4


def fed(travel, tension, direction=1.0):
    line = procedure_state.init_trend(travel[0], tension[0])
    for q, T in zip(travel[1:], tension[1:], strict=True):
        line = procedure_state.update_trend(line, q, T, direction, WINDOW)
    return line


def test_noise_of_a_poor_cell_is_no_stop():
    travel = np.arange(0.0, 20e-3, 2e-5)  # 20 mm/s at 1 kHz
    tension = 3.0 + 0.05 * np.random.default_rng(3).standard_normal(len(travel))
    line, steepest = procedure_state.init_trend(travel[0], tension[0]), 0.0
    for q, T in zip(travel[1:], tension[1:], strict=True):
        line = procedure_state.update_trend(line, q, T, 1.0, WINDOW)
        stiffness = procedure_state.compute_stiffness(line, WINDOW)
        steepest = max(steepest, stiffness if math.isfinite(stiffness) else 0.0)
    assert steepest < 2000.0


def test_an_encoder_that_flickers_back_changes_nothing():
    travel = np.linspace(0.0, 1e-3, 500)
    line = fed(travel, 4000.0 * travel)
    assert procedure_state.update_trend(line, travel[-1] - 1e-6, 0.0, 1.0, WINDOW) == line
    assert procedure_state.update_trend(line, travel[-1], 99.0, 1.0, WINDOW) == line
