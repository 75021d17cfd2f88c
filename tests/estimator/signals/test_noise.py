"""The noise of a channel is told whatever moves in it and however coarsely it is read."""

import numpy as np
import pytest

from estimator.signals.noise import estimate_white_noise

SIGMA = 1e-6


def reading(step, count=6000, seed=0, motion=0.0):
    """Return white noise read in steps, on a motion that takes a third of the time."""
    t = np.linspace(0.0, 1.0, count)
    moved = motion * np.maximum(np.sin(12.0 * t), 0.5)
    noise = SIGMA * np.random.default_rng(seed).standard_normal(count)
    return step * np.round((moved + noise) / step)


@pytest.mark.parametrize("motion", [0.0, 1e-3])
@pytest.mark.parametrize("share", [0.01, 0.5, 1.0, 2.0])
def test_steps_as_coarse_as_the_noise_do_not_hide_it(share, motion):
    step = share * SIGMA
    expected = np.hypot(SIGMA, step / np.sqrt(12.0))
    assert estimate_white_noise(reading(step, motion=motion)) == pytest.approx(expected, rel=0.08)


def test_a_reading_that_stays_where_it_is_has_none():
    assert estimate_white_noise(np.repeat([0.0, 1e-3, 2e-3], 200)) == 0.0
