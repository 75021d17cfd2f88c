"""The motion behind a noisy travel: nearer to it, with its turns, and no more of them."""

import numpy as np
import pytest

from estimator.signals.driving_signal import (
    estimate_travel_drive,
    find_turning_points,
    smooth_signal,
)
from estimator.signals.noise import estimate_white_noise

CASES = [(50.0, 1e-7), (200.0, 1e-6), (1000.0, 5e-6), (50.0, 5e-6)]  # [Hz], [m]


def motion(rate, seed=0):
    """Return a motor's travel [m]: rests, ramps, fast and slow swings, corners of 0.1 s."""
    rng = np.random.default_rng(seed)
    corners = np.cumsum(rng.uniform(0.8, 3.0, 14))
    heights = rng.uniform(0.0, 8e-3, 14)
    for k in (3, 6, 9):
        heights[k] = heights[k - 1]  # rests
    time = np.arange(round(corners[-1] * rate)) / rate
    fine = np.arange(round(corners[-1] * 1000)) / 1000.0
    path = np.interp(fine, np.concatenate([[0.0], corners]), np.concatenate([[0.0], heights]))
    return time, np.interp(time, fine, np.convolve(path, np.ones(100) / 100, mode="same"))


@pytest.mark.parametrize(("rate", "sigma"), CASES)
def test_a_drive_is_nearer_to_the_motion_than_what_was_measured(rate, sigma):
    _, true = motion(rate)
    rng = np.random.default_rng(1)
    measured = true + sigma * rng.standard_normal(len(true))
    found = estimate_travel_drive(measured, estimate_white_noise(measured)).signal
    assert np.sqrt(np.mean((found - true)[100:-100] ** 2)) < 0.75 * sigma


@pytest.mark.parametrize(("rate", "sigma"), CASES)
def test_noise_makes_no_turns_and_hides_none(rate, sigma):
    _, true = motion(rate)
    turns = len(find_turning_points(true, 1e-5))
    for seed in range(3):
        measured = true + sigma * np.random.default_rng(seed).standard_normal(len(true))
        drive = estimate_travel_drive(measured, estimate_white_noise(measured))
        assert turns - 1 <= len(find_turning_points(drive.signal, drive.jitter)) <= turns + 3


@pytest.mark.parametrize("slip", [8e-5, -4e-5, 2e-5])
def test_an_encoder_that_slips_is_not_smoothed_into_a_motion(slip):
    sigma, at = 5e-7, 120
    time = np.arange(240) / 100.0
    true = 2e-3 * np.sin(time) + slip * (time >= time[at])
    measured = true + sigma * np.random.default_rng(3).standard_normal(len(true))
    smoothed, _ = smooth_signal(measured, sigma, time)
    assert np.abs(smoothed - true)[at - 6 : at + 6].max() < 5.0 * sigma
