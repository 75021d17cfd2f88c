"""Records sampled unevenly, or evenly with stamps that jitter: the same noise and times."""

import numpy as np
import pytest

from estimator.diagnosis.record import prepare_record
from studies import hidden_effects

EVERY = 10  # samples of the simulation from one of the record to the next
PERIOD = 0.02  # [s]
TENSION_NOISE, TRAVEL_NOISE = 0.02, 2e-7  # [N], [m]


@pytest.fixture(scope="module")
def fine():
    """A record without effects and without noise, at 500 Hz."""
    rate = EVERY / PERIOD
    return hidden_effects.make(
        6, (), bench="blocked", duration=30.0, rate=rate, noise=0.0, resolution=0.0
    )


def sampled(fine, rows, seed=1):
    """Return times and noisy channels of some samples of a record."""
    rng = np.random.default_rng(seed)
    noisy = {}
    for name, signal in fine.channels.items():
        sigma = TENSION_NOISE if name.endswith("tension") else TRAVEL_NOISE
        noisy[name] = signal[rows] + sigma * rng.standard_normal(len(rows))
    return fine.time[rows], noisy


def rows_of(fine, jitter=0.0, lost=0.0):
    """Return which samples a loop takes that is late or early by a share of its period."""
    rng = np.random.default_rng(2)
    even = np.arange(EVERY, len(fine.time) - EVERY, EVERY)
    off = np.rint(jitter * EVERY * rng.uniform(-1.0, 1.0, len(even))).astype(np.int64)
    rows = np.unique(even + off)
    return rows[rng.random(len(rows)) >= lost]


def assert_noise_is_told(record):
    """Check the noise of all channels that move against what was added."""
    for name in ("proximal_tension", "distal_tension"):
        assert record.noise[name] == pytest.approx(TENSION_NOISE, rel=0.15)
    assert record.noise["proximal_displacement"] == pytest.approx(TRAVEL_NOISE, rel=0.15)


@pytest.mark.parametrize(("jitter", "lost"), [(0.1, 0.0), (0.5, 0.0), (0.0, 0.05), (0.3, 0.05)])
def test_uneven_samples_are_no_noise(fine, jitter, lost):
    time, channels = sampled(fine, rows_of(fine, jitter, lost))
    record = prepare_record(time, channels)
    assert_noise_is_told(record)
    assert record.time[record.measured] == pytest.approx(time - time[0], abs=1e-9)


@pytest.mark.parametrize(("jitter", "lost"), [(0.1, 0.0), (0.5, 0.0), (0.3, 0.05)])
def test_stamps_that_jitter_are_made_even(fine, jitter, lost):
    true, channels = sampled(fine, rows_of(fine, lost=lost))
    off = jitter * PERIOD * np.random.default_rng(3).uniform(-1.0, 1.0, len(true))
    stamps = np.sort(true + off)
    record = prepare_record(stamps, channels)
    assert_noise_is_told(record)
    error = record.time[record.measured] - true
    assert np.std(error) < 0.25 * np.std(off)
    (said,) = [one for one in record.issues if "stamps jitter" in one.what]
    assert not said.excluded


def test_stamps_rounded_to_milliseconds_are_made_even(fine):
    rate, step = 640.0, 1e-3
    true = np.arange(round(25.0 * rate)) / rate
    channels = {name: np.interp(true, fine.time, y) for name, y in fine.channels.items()}
    rng = np.random.default_rng(4)
    noisy = {
        name: y
        + (TENSION_NOISE if "tension" in name else TRAVEL_NOISE) * rng.standard_normal(len(y))
        for name, y in channels.items()
    }
    record = prepare_record(step * np.rint(true / step), noisy)
    assert_noise_is_told(record)


def test_gaps_of_uneven_samples_are_told_too(fine):
    rows = rows_of(fine, jitter=0.3)
    time, channels = sampled(fine, rows[(rows < 4000) | (rows > 4100)])
    said = [one.what for one in prepare_record(time, channels).issues]
    assert sum("uneven time steps" in what for what in said) == 1
    assert "missing samples" in said
