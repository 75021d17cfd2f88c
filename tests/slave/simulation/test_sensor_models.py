import math

import numpy as np
import pytest

from slave.simulation.motor import MotorConfig
from slave.simulation.sensor_models import (
    EncoderConfig,
    LoadCellConfig,
    build_sensors,
    init_sensors,
    measure,
)

DT = 1e-3


def readings(truths, cell=None, encoder=None, seed=0, dt=DT):
    """Return what the housing's two sensors read of `truths`, shape (samples, 2)."""
    sensors = build_sensors(
        [(cell or LoadCellConfig(0.0, 0.0), encoder or EncoderConfig(0), MotorConfig())]
    )
    rng = np.random.default_rng(seed)
    state, rows = None, []
    for tension, travel in truths:
        truth = np.array([[tension], [travel], [1.0], [2.0]])
        state = state or init_sensors(truth)
        state = measure(sensors, state, truth, rng.standard_normal((4, 1)), dt)
        rows.append(state.reading[:, 0])
    return np.array(rows)


def test_perfect_sensors_tell_the_truth_and_those_at_the_tip_always_do():
    rng = np.random.default_rng(1)
    truths = rng.uniform(-1.0, 20.0, (50, 2))
    assert np.array_equal(readings(truths)[:, :2], truths)
    noisy = readings(truths, LoadCellConfig(noise=1.0, bias=3.0, gain=2.0))
    assert np.all(noisy[:, 2:] == [1.0, 2.0])


def test_noise_is_white_and_as_strong_as_it_says():
    read = readings([(5.0, 0.0)] * 4000, LoadCellConfig(noise=0.05, resolution=0.002))[:, 0]
    assert read.mean() == pytest.approx(5.0, abs=5 * 0.05 / math.sqrt(4000))
    assert read.std() == pytest.approx(0.05, rel=0.06)
    assert abs(np.corrcoef(read[1:], read[:-1])[0, 1]) < 0.08


def test_readings_are_multiples_of_the_resolution_and_stop_at_the_range():
    cell = LoadCellConfig(noise=0.3, resolution=0.25, range=2.0)
    steps = readings([(1.6, 0.0)] * 200, cell)[:, 0] / 0.25
    assert np.all(steps == np.round(steps))
    assert steps.max() == 8.0
    assert readings([(-9.0, 0.0)], LoadCellConfig(0.0, 0.0, range=2.0))[0, 0] == -2.0


@pytest.mark.parametrize("dt", [1e-3, 5e-3])
def test_a_cell_of_limited_bandwidth_lags_as_a_filter_of_first_order(dt):
    cell = LoadCellConfig(0.0, 0.0, bandwidth=20.0)
    read = readings([(0.0, 0.0)] + [(1.0, 0.0)] * 40, cell, dt=dt)[1:, 0]
    time = np.arange(1, 41) * dt
    assert read == pytest.approx(1.0 - np.exp(-2.0 * math.pi * 20.0 * time))


def test_the_encoder_counts_lines_of_a_pulley():
    line = 2.0 * math.pi * 0.010 / 67_000
    truths = [(0.0, x) for x in np.linspace(-1e-4, 1e-4, 77)]
    read = readings(truths, encoder=EncoderConfig())[:, 1]
    assert np.abs(read - [x for _, x in truths]).max() <= line / 2 * (1 + 1e-9)
    assert read / line == pytest.approx(np.round(read / line), abs=1e-9)
    assert EncoderConfig(decoding=4).compute_resolution(0.010) == pytest.approx(line / 4)
    assert EncoderConfig(lines=0).compute_resolution(0.010) == 0.0
