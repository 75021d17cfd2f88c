import numpy as np
import pytest

from estimator.law.sheath import Sheath
from estimator.noise_treatment import Treatment, estimate_noise_sigma, update_variance
from estimator.online import online
from estimator.online.online import TendonModel

FRICTIONLESS = Sheath.uniform(0.0, 1.5, 9000.0)


def treated(tension, time, sigma, treatment):
    """Return the tension that drives the estimator's profile: without friction that at the tip."""
    model = TendonModel(FRICTIONLESS, tension_noise=sigma, treatment=treatment)
    return online.run(online.prepare(model), time, tension).distal_tension


@pytest.mark.parametrize("sigma", [0.003, 0.03, 0.3])
def test_noise_is_found_at_rest_and_on_a_ramp(sigma):
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, sigma, 5000)
    ramp = np.linspace(0.0, 20.0, 5000)
    steps = np.repeat(rng.uniform(0.0, 10.0, 10), 500)
    for signal in (noise, noise + ramp, noise + steps):
        assert estimate_noise_sigma(signal) == pytest.approx(sigma, rel=0.05)


@pytest.mark.parametrize("signal", [np.zeros(7), np.full(100, np.nan), np.zeros((10, 10))])
def test_noise_is_not_guessed_from_nothing(signal):
    with pytest.raises(ValueError, match="at least 8 finite samples"):
        estimate_noise_sigma(signal)


@pytest.mark.parametrize("tau", [0.0, 0.002, 0.01])
def test_average_keeps_the_noise_it_says_even_when_the_clock_jitters(tau):
    rng = np.random.default_rng(0)
    dt = np.where(np.arange(200) % 7 == 0, 1e-5, 0.001)
    time = np.cumsum(dt)
    treatment = Treatment(tau, dead_band=0.0)
    ends = [treated(rng.normal(10.0, 0.03, 200), time, 0.03, treatment)[-1] for _ in range(1500)]
    variance = 0.03**2
    for step in dt[1:]:
        variance = update_variance(variance, 0.03, step, tau)
    assert np.std(ends) == pytest.approx(np.sqrt(variance), rel=0.08)


@pytest.mark.parametrize("rate", [82.0, 1000.0])
def test_default_treatment_halves_the_peak_that_a_hold_collects(rate):
    time = np.arange(0.0, 5.0, 1.0 / rate)
    rng = np.random.default_rng(0)
    raw, kept = [], []
    for _ in range(20):
        T = 10.0 + rng.normal(0.0, 0.03, len(time))
        raw.append(T.max() - 10.0)
        kept.append(treated(T, time, 0.03, Treatment()).max() - 10.0)
    assert np.mean(kept) < 0.5 * np.mean(raw)
