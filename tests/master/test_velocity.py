"""Velocity from an encoder by adaptive windowing, against the true one and a fixed filter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from master import velocity
from master.velocity import VelocityWindow

DT = 1e-3
TIME = np.arange(0.0, 3.0, DT)  # [s]
LONGEST = 0.020  # [s]


def estimated(positions, longest=LONGEST):
    windows = VelocityWindow.array()
    return np.array([velocity.update(windows[0], x, DT, longest) for x in positions])


def filtered(positions, constant=0.010):
    """A first-order filter of `constant` [s]."""
    found = [0.0]
    for way in np.diff(positions):
        found.append((constant * found[-1] + way) / (constant + DT))
    return np.array(found)


def sine(frequency, speed):
    turns = 2.0 * np.pi * frequency * TIME
    return speed / (2.0 * np.pi * frequency) * np.sin(turns), speed * np.cos(turns)


def error(found, true):
    return float(np.sqrt(np.mean(np.square(found - true)[500:])))


@pytest.mark.parametrize("resolution", [1e-6, 10e-6, 50e-6])
@pytest.mark.parametrize("frequency", [1.0, 4.0])
def test_it_is_closer_than_a_fixed_filter(resolution, frequency):
    x, v = sine(frequency, 0.020)
    x = np.round(x / resolution) * resolution
    assert error(estimated(x), v) < error(filtered(x), v)


@pytest.mark.parametrize("resolution", [1e-6, 10e-6])
def test_a_swing_at_the_edge_of_stability_is_followed(resolution):
    x, v = sine(30.0, 0.020)
    x = np.round(x / resolution) * resolution
    assert error(estimated(x), v) < 0.5 * error(filtered(x), v)


def test_a_count_to_and_fro_is_little_motion():
    found = estimated(10e-6 * (np.arange(1000) // 7 % 2))
    assert np.abs(found[200:]).max() < 1.5e-3  # a difference of two reads gives 10 mm/s


def test_a_slow_device_moves_in_stairs():
    """125 reports a second of a steady motion."""
    found = estimated(0.020 * 8.0 * DT * (np.arange(1000) // 8))
    assert found[500:] == pytest.approx(0.020, rel=0.25)


@given(st.floats(-0.5, 0.5), st.floats(0.0, 0.05))
def test_a_steady_motion_is_found_with_any_window(speed, longest):
    assert estimated(speed * TIME[:100], longest)[-1] == pytest.approx(speed, abs=1e-9)


def test_ticks_without_time_change_nothing_and_what_is_forgotten_is_gone():
    windows = VelocityWindow.array()
    for tick in range(5):
        found = velocity.update(windows[0], 1e-5 * tick, DT, LONGEST)
    assert velocity.update(windows[0], 1.0, 0.0, LONGEST) == found
    velocity.forget(windows[0])
    assert velocity.update(windows[0], 7.0, DT, LONGEST) == 0.0
