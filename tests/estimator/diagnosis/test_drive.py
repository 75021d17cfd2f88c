"""The motion behind a noisy travel: nearer to it, with its turns, and no more of them."""

import numpy as np
import pytest

from estimator.diagnosis.drive import estimate_travel_drive, find_turning_points, smooth_signal
from estimator.diagnosis.noise import estimate_white_noise

SIGMAS = [1e-7, 1e-6, 5e-6]


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


@pytest.mark.parametrize("sigma", SIGMAS)
@pytest.mark.parametrize("rate", [50.0, 200.0, 1000.0])
def test_a_drive_is_nearer_to_the_motion_than_what_was_measured(rate, sigma):
    _, true = motion(rate)
    rng = np.random.default_rng(1)
    measured = true + sigma * rng.standard_normal(len(true))
    found = estimate_travel_drive(measured, estimate_white_noise(measured)).signal
    assert np.sqrt(np.mean((found - true)[100:-100] ** 2)) < 0.75 * sigma


@pytest.mark.parametrize("sigma", SIGMAS)
@pytest.mark.parametrize("rate", [50.0, 200.0, 1000.0])
def test_noise_makes_no_turns_and_hides_none(rate, sigma):
    _, true = motion(rate)
    turns = len(find_turning_points(true, 1e-5))
    for seed in range(3):
        measured = true + sigma * np.random.default_rng(seed).standard_normal(len(true))
        drive = estimate_travel_drive(measured, estimate_white_noise(measured))
        assert turns - 1 <= len(find_turning_points(drive.signal, drive.jitter)) <= turns + 3


def test_a_motor_that_rests_turns_back_at_the_end_of_the_rest():
    rate, sigma = 100.0, 1e-6
    time = np.arange(1000) / rate
    true = np.interp(time, [0.0, 3.0, 7.0, 10.0], [0.0, 5e-3, 5e-3, 0.0])
    reversals = []
    for seed in range(20):
        measured = true + sigma * np.random.default_rng(seed).standard_normal(len(true))
        falls = np.diff(estimate_travel_drive(measured, sigma).signal) < 0.0
        reversals.append(float(time[320 + np.argmax(falls[320:])]))
    assert np.median(reversals) == pytest.approx(7.0, abs=0.1)
    assert np.quantile(reversals, 0.25) > 6.5


def test_noise_is_told_apart_from_motion():
    _, true = motion(200.0)
    for sigma in SIGMAS:
        measured = true + sigma * np.random.default_rng(0).standard_normal(len(true))
        assert estimate_white_noise(measured) == pytest.approx(sigma, rel=0.15)


def test_without_noise_nothing_is_smoothed():
    _, true = motion(100.0)
    smoothed, left = smooth_signal(true, 0.0)
    np.testing.assert_array_equal(smoothed, true)
    assert not left.any()


def test_what_noise_is_left_is_known():
    rng = np.random.default_rng(2)
    true = np.linspace(0.0, 1e-3, 4000)
    smoothed, left = smooth_signal(true + 1e-6 * rng.standard_normal(4000), 1e-6)
    inside = slice(100, -100)
    assert np.std((smoothed - true)[inside]) < 2.0 * np.sqrt(np.mean(left[inside] ** 2))
    assert left[inside].mean() < 0.35e-6


@pytest.mark.parametrize("slip", [8e-5, -4e-5, 2e-5])
def test_an_encoder_that_slips_is_not_smoothed_into_a_motion(slip):
    sigma, at = 5e-7, 120
    time = np.arange(240) / 100.0
    true = 2e-3 * np.sin(time) + slip * (time >= time[at])
    measured = true + sigma * np.random.default_rng(3).standard_normal(len(true))
    smoothed, _ = smooth_signal(measured, sigma, time)
    assert np.abs(smoothed - true)[at - 6 : at + 6].max() < 5.0 * sigma
