"""The corrected equations against the brute-force chain; their printed forms must fail there."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from studies.brute.chain import Chain, Force, Position
from studies.paper import equations as cf
from tests.studies.paper import other_equations as eq

MU, R, L, EA = 0.1, 0.15, 1.5, 9000.0
K = MU * L / R
PEAK, TROUGH = 20.0, 1.0
BENT = ((0.3, 0.05), (0.9, 0.6), (0.3, 0.12))  # (length, radius) [m]
LENGTHS, RADII = zip(*BENT, strict=True)


def chain_through(levels, sections=((L, R),), tension=0.0, beads=160):
    """Return (T_in, T_out, e) at 16 states of each monotone move from level to level."""
    chain = Chain(sections, MU, EA, tension=tension, beads=beads)
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
    assert eq.bend_elongation(T_in, MU, R, EA, L) == pytest.approx(e, rel=1e-4)
    assert eq.bend_elongation_from_ends(T_in, T_out, MU, R, EA) == pytest.approx(e, rel=1e-4)
    assert eq.uniform_pull_constant(K, L, EA) * T_in == pytest.approx(e, rel=1e-4)


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
    M_e = eq.uniform_pull_constant(K, L, EA)
    form = cf.compute_release_elongation(T_in[~waiting], M_e, K)
    assert form == pytest.approx(e[~waiting], rel=1e-4)
    back = eq.release_tension_from_elongation(PEAK, e[waiting], K, L, EA)
    assert back == pytest.approx(T_in[waiting], rel=5e-3)


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


def test_front_is_where_the_tension_peaks_and_dips():
    beads = 160
    chain = Chain(((L, R),), MU, EA, beads=beads)
    for T in [PEAK, 9.0]:
        chain.move(Force(T), Position(0.0))
    x = np.argmax(chain.tensions) * L / beads
    assert eq.pull_to_release_front(PEAK, 9.0, K, L) == pytest.approx(x, abs=1.5 * L / beads)
    for T in [TROUGH, 3.0]:
        chain.move(Force(T), Position(0.0))
    x = np.argmin(chain.tensions) * L / beads
    assert eq.release_to_pull_front(TROUGH, 3.0, K, L) == pytest.approx(x, abs=1.5 * L / beads)


def test_areas_a_and_b_are_the_areas_beside_the_front():
    T_in = 8.0
    X = eq.pull_to_release_front(PEAK, T_in, K, L)
    before, _ = quad(lambda x: T_in * math.exp(K * x / L), 0.0, X)
    beyond, _ = quad(lambda x: PEAK * math.exp(-K * x / L), X, L)
    e_A = eq.pull_to_release_elongation_before_front(T_in, X, K, L, EA)
    e_B = eq.pull_to_release_elongation_beyond_front(T_in, X, K, L, EA)
    assert (e_A, e_B) == pytest.approx((before / EA, beyond / EA))
    assert e_A + e_B == pytest.approx(cf.compute_pull_to_release_elongation(PEAK, T_in, K, L, EA))


def test_sections_of_different_curvature():
    K_bent = cf.compute_friction_coordinates(MU, LENGTHS, RADII)[-1]
    pull, release, again = chain_through([0.1, PEAK, TROUGH, PEAK], BENT, beads=400)
    T_in, T_out, e = pull
    assert cf.compute_pull_tip_tension(T_in, K_bent) == pytest.approx(T_out, rel=1e-3)
    assert cf.compute_pull_constant(MU, LENGTHS, RADII, EA) * T_in == pytest.approx(e, rel=1e-3)
    M_rel = cf.compute_release_constant(MU, LENGTHS, RADII, EA)
    assert M_rel * release[0][-1] == pytest.approx(release[2][-1], rel=1e-3)
    printed = cf.compute_pull_constant(MU, LENGTHS, RADII, EA) * math.exp(K_bent)
    assert printed != pytest.approx(M_rel, rel=0.1)
    for turn, (T_in, _, e) in ((PEAK, release), (TROUGH, again)):
        form = [eq.transition_elongation(turn, T, MU, LENGTHS, RADII, EA) for T in T_in[1:]]
        assert form == pytest.approx(list(e[1:]), rel=2e-3)


def test_backlash_is_the_travel_the_tip_does_not_notice(uniform):
    for turn, swing, form in (
        (PEAK, uniform[1], eq.pull_to_release_backlash),
        (TROUGH, uniform[2], eq.release_to_pull_backlash),
    ):
        T_in, _, e = swing
        last = np.interp(2 * K, np.abs(np.log(T_in / turn)), e)
        assert form(turn, K, L, EA) == pytest.approx(abs(last - e[0]), rel=0.02)


def test_virgin_pull_from_pretension():
    T_p = 4.0
    (T_in, T_out, e) = chain_through([T_p, 25.0], tension=T_p)[0]
    early = T_in < T_p * math.exp(K)
    assert T_out[early] == pytest.approx(np.full(early.sum(), T_p))
    assert eq.virgin_elongation(T_p, T_in[early], K, L, EA) == pytest.approx(e[early], rel=1e-4)


@pytest.mark.parametrize("true_K", [0.05, 0.5, 1.0, 3.0, 8.0])
def test_friction_from_the_pull_constant(true_K):
    M_e = eq.uniform_pull_constant(true_K, L, EA)
    root = brentq(lambda k: math.exp(-k) - 1 + M_e * EA / L * k, 0.02, 20.0, xtol=1e-14)
    assert cf.compute_friction_from_pull(M_e, L, EA) == pytest.approx(root, rel=1e-7)
    assert root == pytest.approx(true_K, rel=1e-7)


def test_section_by_section():
    x = np.linspace(0.0, sum(LENGTHS), 3001)
    T = [eq.section_tension(PEAK, MU, LENGTHS, RADII, v) for v in x]
    ends = np.searchsorted(x, np.cumsum(LENGTHS) - 1e-9)
    areas = [np.trapezoid(T[: k + 1], x[: k + 1]) / EA for k in ends]
    assert cf.compute_section_elongations(PEAK, MU, LENGTHS, RADII, EA) == pytest.approx(
        areas, rel=1e-3
    )
    inside = eq.section_tension(PEAK, MU, LENGTHS, RADII, 0.1)
    assert inside == pytest.approx(eq.bend_tension(PEAK, MU, RADII[0], 0.1))
