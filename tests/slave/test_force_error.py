"""How far the estimate was from the bench."""

import math

import numpy as np
import pytest

from estimator.law.sheath import Sheath
from estimator.online.tendon_model import TendonModel
from slave.force_error import Score


def test_figures_are_those_of_numpy():
    random = np.random.default_rng(1)
    measured = random.uniform(1.0, 9.0, 500)
    estimate = measured + random.normal(0.0, 0.3, 500)
    score = Score()
    for e, m in zip(estimate, measured, strict=True):
        score.add(e, e - 0.5, e + 0.5, m)
    error = estimate - measured
    summary = score.summarise()
    assert summary["rmse_N"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert summary["mean_N"] == pytest.approx(np.mean(np.abs(error)))
    assert summary["max_N"] == pytest.approx(np.max(np.abs(error)))
    assert summary["full_scale_N"] == measured.max()
    assert summary["inside_interval"] == pytest.approx(np.mean(np.abs(error) <= 0.5))


def test_without_a_bench_sensor_there_is_nothing_to_say():
    score = Score()
    score.add(1.0, 0.0, 2.0, math.nan)
    assert score.summarise() is None


@pytest.mark.parametrize(("noise", "pulled"), [(0.0, True), (0.004, True), (0.01, False)])
def test_a_force_that_hardly_stands_out_of_the_noise_is_no_full_scale(noise, pulled):
    score = Score([TendonModel(Sheath.uniform(1.0, 1.5, 9000.0), tension_noise=noise)])
    score.add(1.2, 0.0, 2.0, 1.1)
    assert score.summarise()["pulled"] is pulled
