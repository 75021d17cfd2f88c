"""Distributed play over two days of one bench: strands that let go one after another.

The data are of plays that share no code with the model: eighty strands whose thresholds are spread
log-normally, and a cell that reads too little. Another day has other motion, noise and friction.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import nnls

from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.baseline import fit_baseline
from estimator.diagnosis.dataset import build_dataset, use_all_samples
from estimator.diagnosis.fit import fit_record_parameters, refit_baseline
from estimator.diagnosis.record import prepare_record
from estimator.effects import CATALOGUE

GAIN, SPREAD, STRANDS = 0.85, 0.5, 80
CHECKED = {"distal_tension_gain", "distributed_play"}


class Day(NamedTuple):
    """What was measured on a day."""

    time: np.ndarray  # [s]
    T_in: np.ndarray  # [N]
    T_out: np.ndarray  # [N]

    @property
    def record(self):
        return prepare_record(
            self.time, {"proximal_tension": self.T_in, "distal_tension": self.T_out}
        )


def moved(rng, samples, rate, pause):
    """Return a tension [N] pulled by hand: half waves between random depths, `pause` [s] long."""
    time = np.arange(samples) / rate
    turns = np.cumsum(rng.uniform(*pause, samples))
    turns = np.concatenate([[0.0], turns[: np.searchsorted(turns, time[-1]) + 1]])
    depths = rng.uniform(0.3, 12.0, len(turns))
    depths[1::3] = rng.uniform(0.2, 1.5, len(depths[1::3]))
    k = np.searchsorted(turns, time, side="right") - 1
    share = 0.5 - 0.5 * np.cos(np.pi * (time - turns[k]) / (turns[k + 1] - turns[k]))
    return time, depths[k] + share * (depths[k + 1] - depths[k])


def strand(tension, K):
    """Return a tension after friction of K alone."""
    now, out = 0.0, []
    for T in tension.tolist():
        if now > T * np.exp(K):
            now = T * np.exp(K)
        elif now < T * np.exp(-K):
            now = T * np.exp(-K)
        out.append(now)
    return np.array(out)


def day(seed, K, noise, pause, samples=1000, rate=40.0):
    rng = np.random.default_rng(seed)
    time, T_in = moved(rng, samples, rate, pause)
    thresholds = K * np.exp(SPREAD * np.random.default_rng(99).standard_normal(STRANDS))
    T_out = GAIN * np.mean([strand(T_in, threshold) for threshold in thresholds], axis=0)
    return Day(
        time,
        T_in + noise * rng.standard_normal(samples),
        T_out + noise * rng.standard_normal(samples),
    )


@pytest.fixture(scope="module")
def days():
    return day(1, 0.6, 0.01, (0.2, 1.2)), day(2, 0.62, 0.015, (0.4, 2.5))


def by_plays(first, second, count):
    """Return the RMSE [N] on the second day of weighted plays with a gain, fitted to the first."""

    def plays(of, most):
        return np.column_stack([strand(of.T_in, most * j / count) for j in range(1, count + 1)])

    fits = []
    for most in np.linspace(0.1, 2.5, 49):
        weights, error = nnls(plays(first, most), first.T_out)
        fits.append((error, most, weights))
    _, most, weights = min(fits, key=lambda fit: fit[0])
    return rms(plays(second, most) @ weights - second.T_out)


def rms(off):
    return float(np.sqrt(np.mean(off**2)))


def by_model(first, second, *begin):
    """Return the same of the law with effects, begun at values."""
    effects = tuple(
        (next(e for e in CATALOGUE if e.name == name and len(e.parameters) == len(v)), v)
        for name, v in begin
    )
    dataset = use_all_samples(build_dataset([first.record]))
    plain = fit_baseline(dataset)
    fit = refit_baseline(dataset, plain._replace(model=plain.model._replace(effects=effects)))
    there = fit_record_parameters(build_dataset([second.record]), fit)
    return rms(there.simulated[0].signals["distal_tension"] - second.T_out)


def test_the_model_of_one_day_predicts_another_as_well_as_five_weighted_plays(days):
    gain = ("distal_tension_gain", (-0.1,))
    five, one = (by_plays(*days, count) for count in (5, 1))
    spectrum = by_model(*days, gain, ("distributed_play", (0.1, 0.5, 0.3, 0.2)))
    spread = by_model(*days, gain, ("distributed_play", (0.5, 0.5)))
    law = by_model(*days, gain)
    assert spectrum < 1.02 * five
    assert spread < 1.15 * five
    assert max(spectrum, spread) < 0.6 * min(one, law)


@pytest.mark.slow
def test_distributed_play_is_found_beside_a_gain():
    """Plays of high thresholds imitate the gain: alone they explain more than it does."""
    first = day(1, 0.6, 0.01, (0.2, 1.2), samples=2400)
    second = day(2, 0.62, 0.015, (0.4, 2.5), samples=2400)
    effects = [e for e in CATALOGUE if e.name in CHECKED]
    found = diagnose_records([first.record], effects, validate=[second.record])
    assert set(found.causes) == CHECKED
    assert found.parameters["distal_tension_gain.gain"].value == pytest.approx(GAIN - 1.0, abs=0.03)
    law = found.after.validation["distal_tension"].rmse
    assert law < 1.1 * by_plays(first, second, 5)
    assert law < 0.3 * found.before.validation["distal_tension"].rmse
