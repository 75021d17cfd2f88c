import math

import numpy as np
import pytest

from estimator.calibration import CalibrationError, calibrate, friction_from_elongation
from estimator.sheath import Section, Sheath
from tests.brute.chain import Chain, Force, Position


def loop(sheath, low=0.2, high=20.0, n=800, beads=80):
    """One blocked-tip loop of the brute-force chain: T_in and q_p, free of noise."""
    sections = [(section.length, section.radius) for section in sheath.sections]
    chain = Chain(sections, sheath.friction, sheath.axial_stiffness, beads=beads)
    rows = []
    for T in np.concatenate([np.linspace(low, high, n), np.linspace(high, low, n)]):
        chain.move(Force(T), Position(0.0))
        rows.append((T, chain.travel[0]))
    return tuple(np.array(rows).T)


@pytest.fixture(scope="module")
def clean():
    return loop(Sheath.uniform(1.0, 1.5, 9000.0))


def noisy(record, seed, sigma_T=0.02, sigma_q=1e-6):
    rng = np.random.default_rng(seed)
    T, q = record
    return T + rng.normal(0.0, sigma_T, len(T)), q + rng.normal(0.0, sigma_q, len(q))


def test_one_loop_gives_friction_and_stiffness_without_being_told_either(clean):
    result = calibrate(*noisy(clean, 0))
    assert result.K.value == pytest.approx(1.0, abs=0.015)
    assert result.stiffness_per_length.value == pytest.approx(6000.0, rel=0.01)
    assert result.T_peak.value == pytest.approx(20.0, abs=0.1)
    assert result.uniform
    assert result.K_paper is None


def test_stated_uncertainties_cover_the_truth(clean):
    errors = []
    for seed in range(40):
        result = calibrate(*noisy(clean, seed), axial_stiffness=9000.0, length=1.5)
        truths = (
            (result.K_loop, 1.0),
            (result.K_branch, 1.0),
            (result.K_paper, 1.0),
            (result.stiffness_per_length, 6000.0),
        )
        errors.append([(m.value - truth) / m.uncertainty for m, truth in truths])
    inside = (np.abs(errors) < 2.0).mean(axis=0)
    assert (inside > 0.85).all(), inside
    assert (np.std(errors, axis=0) > 0.5).all(), "uncertainties far too large cover nothing"


def test_more_noise_is_more_uncertainty(clean):
    quiet, loud = calibrate(*noisy(clean, 1, 0.01)), calibrate(*noisy(clean, 1, 0.04))
    assert loud.K.uncertainty > 2.0 * quiet.K.uncertainty


@pytest.mark.parametrize(
    "sections",
    [
        (Section(0.2, 0.05), Section(1.3, 0.5)),
        (Section(1.3, 0.5), Section(0.2, 0.05)),
        (Section(0.3, 0.05), Section(0.9, 0.6), Section(0.3, 0.12)),
    ],
    ids=["tight at the motor", "tight at the tip", "tight, wide, medium"],
)
def test_uneven_curvature_is_noticed_and_does_not_mislead(sections):
    sheath = Sheath(sections, 0.13, 9000.0)
    result = calibrate(*noisy(loop(sheath, n=600, beads=120), 0))
    assert not result.uniform
    assert not result.agree
    assert abs(result.K_loop.value - sheath.K) > 0.2, "the uniform method should be wrong here"
    assert abs(result.K.value - sheath.K) < 2.5 * result.K.uncertainty < 0.2 * sheath.K
    assert result.stiffness_per_length.value == pytest.approx(6000.0, rel=0.03)


def test_wrong_stiffness_shows_as_disagreement_of_the_paper_alone(clean):
    result = calibrate(*noisy(clean, 0), axial_stiffness=8000.0, length=1.5)
    assert result.uniform
    assert not result.agree
    assert result.K.value == pytest.approx(1.0, abs=0.015)


def test_closed_form_solves_the_papers_equation():
    for K in (0.1, 0.5, 1.0, 2.0, 3.0):
        m = -math.expm1(-K) / K
        found = friction_from_elongation(m * 1.5 / 9000.0, 9000.0, 1.5)
        assert math.exp(-found) == pytest.approx(1.0 - m * found, rel=1e-9)
        assert found == pytest.approx(K, rel=1e-6)


def test_refuses_more_stretch_than_a_free_tendon(clean):
    with pytest.raises(CalibrationError, match=r"M_e EA/L is 1\.\d+, must lie between 0 and 1"):
        calibrate(*clean, axial_stiffness=15000.0, length=1.5)


def test_refuses_what_cannot_carry_a_calibration(clean):
    T, q = clean
    half = len(T) // 2
    peak_only = slice(half - 30, half + 30)
    broken = T.copy()
    broken[7] = math.nan
    cases = [
        ((T[:30], q[:30]), "30 samples, at least 40"),
        ((broken, q), "1 samples are not finite, the first at index 7"),
        ((T[:half], q[:half]), "no release after the pull"),
        ((T[half:], q[half:]), "no pull before the release"),
        ((T, q[:-1]), "rows of equal length"),
        ((T[peak_only], q[peak_only]), "too little of the pull"),
        ((np.full(100, 3.0), np.zeros(100)), "no pull|nothing moves|no release"),
    ]
    for record, message in cases:
        with pytest.raises(CalibrationError, match=message) as caught:
            calibrate(*record)
        assert "\n" not in str(caught.value)
    with pytest.raises(CalibrationError, match="needs both"):
        calibrate(T, q, axial_stiffness=9000.0)


def test_refuses_a_release_that_stays_inside_the_backlash(clean):
    T, q = clean
    half = len(T) // 2
    for stop in (4.0, 6.0, 10.0):  # the whole tendon slides below 20 e^-2 = 2.7 N
        kept = np.concatenate([np.ones(half, bool), T[half:] > stop])
        with pytest.raises(CalibrationError, match=r"before the whole tendon slides back|release"):
            calibrate(*noisy((T[kept], q[kept]), 0))
