"""The paper's estimator against the brute-force chain of a uniform sheath, where it is exact."""

import math

import numpy as np
import pytest

from studies.brute_force.chain import Chain, Force, Position
from studies.paper import paper_method
from studies.paper.paper_method import Phase

K, L, EA, MU = 0.6, 1.5, 9000.0, 0.15
UNEVEN = ((0.2, 0.05), (1.3, 0.5))  # (length, radius) [m]: a tight bend at the motor


def moved_through(levels, sections=((L, MU * L / K),), n=100):
    """Return T_in, T_out, e of a chain with its tip held, T_in moved through `levels`."""
    chain = Chain(sections, MU, EA, beads=150, tension=1e-3)
    rows = []
    for low, high in zip((1e-3, *levels[:-1]), levels, strict=True):
        for T in np.linspace(low, high, n):
            chain.move(Force(T), Position(0.0))
            rows.append((chain.T_in, chain.T_out, chain.elongation))
    return np.array(rows).T


def largest_errors(found, T_out, e):
    return (
        np.abs(found.distal_tension - T_out).max() / T_out.max(),
        np.abs(found.elongation - e).max() / e.max(),
    )


@pytest.fixture(scope="module")
def calibrated():
    """The model as the first pull of a chain gives it: M_e = e/T_in."""
    T_in, _, e = moved_through((20.0,))
    return paper_method.build_model(e[-1] / T_in[-1], L, EA)


def run(model, tension, continued=False):
    return paper_method.run_method(model, np.arange(len(tension)), tension, 0.0, continued)


@pytest.mark.parametrize("continued", [False, True])
@pytest.mark.parametrize("levels", [(20.0, 5.0, 20.0), (20.0, 1.0, 10.0, 1.0, 20.0)])
def test_full_pulls_and_releases_of_a_uniform_sheath_are_exact(calibrated, levels, continued):
    T_in, T_out, e = moved_through(levels)
    force, elongation = largest_errors(run(calibrated, T_in, continued), T_out, e)
    assert force < 1e-4
    assert elongation < 1e-4


def test_a_reversal_inside_a_transition_makes_the_paper_jump_and_not_its_continuation(calibrated):
    T_in, T_out, e = moved_through((20.0, 8.0, 15.0))
    assert T_out[-1] == pytest.approx(T_out[99])  # the tip never heard of it
    jumped, _ = largest_errors(run(calibrated, T_in), T_out, e)
    assert jumped > 0.3
    force, elongation = largest_errors(run(calibrated, T_in, continued=True), T_out, e)
    assert force < 1e-4
    assert elongation < 1e-4


def test_uneven_curvature_misleads_it_as_theory_says():
    T_in, T_out, e = moved_through((20.0,), UNEVEN)
    model = paper_method.build_model(e[-1] / T_in[-1], L, EA)
    true = MU * sum(length / radius for length, radius in UNEVEN)
    assert true == pytest.approx(0.99)
    assert pytest.approx(1.63, abs=0.01) == model.K
    low = run(model, T_in).distal_tension[-1] / T_out[-1] - 1.0
    assert low == pytest.approx(-0.47, abs=0.01)


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_noise_is_no_reversal(calibrated, noise):
    clean = np.concatenate([np.linspace(0.0, 20.0, 3000), np.full(2000, 20.0)])
    tension = clean + noise * np.random.default_rng(1).standard_normal(len(clean))
    found = paper_method.run_method(calibrated, 1e-3 * np.arange(len(clean)), tension, noise)
    assert set(found.phase) == {Phase.PULL}
    off = found.distal_tension - clean * math.exp(-K)
    lag = paper_method.TIME_CONSTANT * 20.0 / 3.0
    assert np.abs(off).max() < math.exp(-K) * (lag + 2.0 * noise)
