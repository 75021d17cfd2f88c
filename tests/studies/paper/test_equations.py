"""The corrected equations against the brute-force chain; their printed forms must fail there."""

import math

import numpy as np
import pytest

from studies.brute_force.chain import Chain, Force, Position
from studies.paper import equations as cf

MU, R, L, EA = 0.1, 0.15, 1.5, 9000.0
K = MU * L / R
PEAK, TROUGH = 20.0, 1.0
BENT = ((0.3, 0.05), (0.9, 0.6), (0.3, 0.12))  # (length, radius) [m]
LENGTHS, RADII = zip(*BENT, strict=True)


def chain_through(levels, sections=((L, R),), beads=160):
    """Return (T_in, T_out, e) at 16 states of each monotone move from level to level."""
    chain = Chain(sections, MU, EA, beads=beads)
    swings = []
    for low, high in zip([levels[0], *levels[:-1]], levels, strict=True):
        rows = []
        for T in np.linspace(low, high, 16):
            chain.move(Force(T), Position(0.0))
            rows.append((chain.T_in, chain.T_out, chain.elongation))
        swings.append(np.array(rows).T)
    return swings[1:]


@pytest.fixture(scope="module")
def uniform():
    return chain_through([0.1, PEAK, TROUGH, PEAK])


def test_pull(uniform):
    T_in, T_out, e = uniform[0]
    assert cf.compute_pull_tip_tension(T_in, K) == pytest.approx(T_out, rel=1e-4)
    assert cf.compute_pull_constant(MU, (L,), (R,), EA) * T_in == pytest.approx(e, rel=1e-4)


def test_pull_to_release_then_release(uniform):
    T_in, T_out, e = uniform[1]
    waiting = T_in > PEAK * math.exp(-2 * K)
    assert 5 < waiting.sum() < 16
    held = np.full(waiting.sum(), cf.compute_pull_to_release_tension(PEAK, K))
    assert T_out[waiting] == pytest.approx(held, rel=1e-4)
    form = cf.compute_pull_to_release_elongation(PEAK, T_in[waiting], K, L, EA)
    assert form == pytest.approx(e[waiting], rel=2e-4)
    assert T_out[~waiting] == pytest.approx(
        cf.compute_release_tip_tension(T_in[~waiting], K), rel=1e-4
    )
    M_e = cf.compute_pull_constant(MU, (L,), (R,), EA)
    form = cf.compute_release_elongation(T_in[~waiting], M_e, K)
    assert form == pytest.approx(e[~waiting], rel=1e-4)


def test_release_to_pull(uniform):
    T_in, T_out, e = uniform[2]
    waiting = T_in < TROUGH * math.exp(2 * K)
    assert 4 < waiting.sum() < 16
    held = np.full(waiting.sum(), cf.compute_release_to_pull_tension(TROUGH, K))
    assert T_out[waiting] == pytest.approx(held, rel=2e-4)
    form = cf.compute_release_to_pull_elongation(TROUGH, T_in[waiting], K, L, EA)
    assert form == pytest.approx(e[waiting], rel=2e-4)


def test_the_printed_24_is_off_by_twice_the_friction(uniform):
    T_out = uniform[2][1][3]
    assert TROUGH * math.exp(-K) == pytest.approx(T_out * math.exp(-2 * K), rel=1e-3)


def test_sections_of_different_curvature():
    s = cf.compute_friction_coordinates(MU, LENGTHS, RADII)
    pull, release, _ = chain_through([0.1, PEAK, TROUGH, PEAK], BENT, beads=400)
    T_in, T_out, e = pull
    assert cf.compute_pull_tip_tension(T_in, s[-1]) == pytest.approx(T_out, rel=1e-3)
    M_e = cf.compute_pull_constant(MU, LENGTHS, RADII, EA)
    assert M_e * T_in == pytest.approx(e, rel=1e-3)
    M_rel = cf.compute_release_constant(MU, LENGTHS, RADII, EA)
    assert M_rel * release[0][-1] == pytest.approx(release[2][-1], rel=1e-3)
    assert M_e * math.exp(s[-1]) != pytest.approx(M_rel, rel=0.1)  # as printed


def test_the_elongation_up_to_a_section_is_that_of_a_sheath_that_ends_there():
    ends = cf.compute_section_elongations(PEAK, MU, LENGTHS, RADII, EA)
    for k, e in enumerate(ends, start=1):
        (pull,) = chain_through([0.1, PEAK], BENT[:k])
        assert pull[2][-1] == pytest.approx(e, rel=1e-3)


@pytest.mark.parametrize("true_K", [0.05, 0.5, 1.0, 3.0, 8.0])
def test_friction_from_the_pull_constant(true_K):
    M_e = -L * math.expm1(-true_K) / (EA * true_K)  # eq. (12)
    assert cf.compute_friction_from_pull(M_e, L, EA) == pytest.approx(true_K, rel=1e-7)
