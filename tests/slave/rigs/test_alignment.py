"""Readings of two buses as samples of one time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slave.drivers.driver import BusReading
from slave.drivers.microcontroller.driver import ClockMap
from slave.rigs.hardware import Aligner

SPEED, RATE = 3.0, -50.0  # [counts/s] of motor and cell
NONE = np.empty(0)


def motor(time_s):
    return BusReading(time_s, np.array([SPEED * time_s]), NONE)


def cell(time_s):
    return BusReading(time_s, NONE, np.array([RATE * time_s]))


def run(motor_times, cell_times):
    """Hand readings over in the order of their times; return aligner and samples."""
    aligner, samples = Aligner(), []
    events = sorted([(t, True) for t in motor_times] + [(t, False) for t in cell_times])
    for time_s, is_motor in events:
        new = [motor(time_s)] if is_motor else []
        samples += aligner.align(new, [] if is_motor else [cell(time_s)])
    return aligner, samples


@given(
    st.lists(st.floats(1e-4, 0.02), min_size=3, max_size=60),
    st.lists(st.floats(1e-4, 0.02), min_size=3, max_size=60),
)
def test_whatever_the_rates_samples_are_in_order_once_and_of_one_time(motor_gaps, cell_gaps):
    _, samples = run(np.cumsum(motor_gaps), np.cumsum(cell_gaps))
    times = [time_s for time_s, *_ in samples]
    assert np.all(np.diff(times) > 0.0)
    for time_s, position, tension in samples:
        assert position == pytest.approx([SPEED * time_s], abs=1e-9)
        assert tension == pytest.approx([RATE * time_s], abs=1e-9)


@pytest.mark.parametrize("silent", ["motors", "cells"])
def test_without_one_of_the_two_there_is_no_sample(silent):
    aligner = Aligner()
    run_in = [k * 1e-3 for k in range(50)]
    list(aligner.align(map(motor, run_in), map(cell, run_in)))
    later = [0.05 + k * 1e-3 for k in range(50)]
    found = list(
        aligner.align(
            [] if silent == "motors" else map(motor, later),
            [] if silent == "cells" else map(cell, later),
        )
    )
    assert len(found) <= 1


@given(st.integers(0, 2**32 - 1), st.floats(-100e-6, 100e-6), st.integers(0, 1000))
def test_device_times_are_found_again_below_the_jitter_of_their_arrival(first, drift, seed):
    clock, random = ClockMap(), np.random.default_rng(seed)
    errors = []
    for k in range(400):
        sampled_s = 50.0 + 1e-3 * k
        device_us = (first + round(1e3 * k * (1.0 + drift))) % (1 << 32)
        arrival_s = sampled_s + 100e-6 + random.exponential(1e-3)
        errors.append(clock(device_us, arrival_s) - sampled_s)
    late = np.array(errors[200:])
    assert np.all(late >= 0.0)
    assert np.all(late < 0.6e-3)  # arrivals are late by up to 6 ms
