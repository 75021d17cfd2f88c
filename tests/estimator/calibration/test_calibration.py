import itertools
import math
from functools import cache

import numpy as np
import pytest

from estimator.calibration.calibration import (
    CalibrationError,
    calibrate,
    compute_friction_from_elongation,
)
from estimator.calibration.pattern import Tail
from estimator.law.sheath import Section, Sheath
from estimator.law.transmission import build_slack_profile, build_tables, simulate_tensions
from studies.brute_force.chain import Chain, Force, Position, Spring

HELD = Position(0.0)
COUNT = 2.0 * math.pi * 0.010 / 67_000  # [m] of the encoder


def path(*turns):
    """Tensions from turn to turn, closest behind a turn and where tension is low."""
    legs = [
        np.unique(
            np.concatenate(
                [np.geomspace(a, b, 100), np.linspace(a, b, 80), a + (b - a) * SPACED_SQUARE]
            )
        )[:: 1 if b > a else -1]
        for a, b in itertools.pairwise(turns)
    ]
    return np.concatenate(legs)


SPACED_SQUARE = 0.3 * np.linspace(0.0, 1.0, 40) ** 2


def fine(sheath):
    """Sections of little friction each, so that the chain gives a tight bend its beads."""
    for section in sheath.sections:
        parts = max(1, math.ceil(sheath.friction * section.bend_angle / 0.03))
        yield from [(section.length / parts, section.radius)] * parts


def record(sheath, *turns, tip=HELD, seconds=(1.0, 3.0, 3.0, 3.0), asymmetry=1.0):
    """T_in and q_p of the brute-force chain at 1 kHz, the motor at constant speed, no noise."""
    chain = Chain(
        list(fine(sheath)),
        sheath.friction,
        sheath.axial_stiffness,
        beads=40,
        asymmetry=asymmetry,
        tension=0.05,
    )
    chain.move(Force(turns[0]), tip)
    T_all, q_all = [], []
    for (a, b), duration in zip(itertools.pairwise(turns), seconds, strict=False):
        T = path(a, b)
        q = np.array([chain.move(Force(t), tip).travel[0] for t in T])
        at = np.linspace(q[0], q[-1], round(duration * 1000))
        order = np.argsort(q, kind="stable")
        q_all += [at, np.full(200, at[-1])]
        T_all += [np.interp(at, q[order], T[order]), np.full(200, T[-1])]
    return np.concatenate(T_all), np.concatenate(q_all)


def measured(clean, seed, sigma=0.02):
    T, q = clean
    noise = np.random.default_rng(seed).normal(0.0, sigma, len(T))
    return T + noise, np.round(q / COUNT) * COUNT


UNIFORM = Sheath.uniform(1.0, 1.5, 9000.0)


@pytest.fixture(scope="module")
def clean():
    return record(UNIFORM, 0.2, 20.0, 0.2, 20.0)


@pytest.fixture(scope="module")
def result(clean):
    return calibrate(*measured(clean, 0), axial_stiffness=9000.0, length=1.5)


def test_a_loop_gives_friction_and_stiffness(result):
    assert result.K.value == pytest.approx(1.0, abs=0.004)
    assert result.K_loop.value == pytest.approx(1.0, abs=0.01)
    assert result.stiffness_per_length.value == pytest.approx(6000.0, rel=0.002)
    assert result.T_peak.value == pytest.approx(20.0, abs=0.03)
    assert result.uniform
    assert result.agree
    assert 0.5 < result.misfit < 1.5


def test_a_pull_and_a_release_suffice(clean):
    T, q = clean
    end = 1200 + 3200
    result = calibrate(*measured((T[:end], q[:end]), 0))
    assert result.K.value == pytest.approx(1.0, abs=0.01)
    assert result.stiffness_per_length.value == pytest.approx(6000.0, rel=0.005)
    assert result.K_paper is None  # nobody told EA and L


UNEVEN = {
    "tight at the motor": Sheath((Section(0.2, 0.05), Section(1.3, 0.5)), 0.13, 9000.0),
    "tight at the tip": Sheath((Section(1.3, 0.5), Section(0.2, 0.05)), 0.13, 9000.0),
    "three bends": Sheath(
        (Section(0.3, 0.05), Section(0.9, 0.6), Section(0.3, 0.12)), 0.1, 12000.0
    ),
    "straight, bend, straight": Sheath(
        (Section(0.4), Section(0.5, 0.1), Section(0.7)), 0.2, 6000.0
    ),
    "straight between": Sheath((Section(0.3, 0.2), Section(0.5), Section(0.6, 0.08)), 0.15, 9000.0),
    "K 1.8": Sheath((Section(0.5, 0.3), Section(0.4, 0.06), Section(0.6, 0.2)), 0.1588, 14000.0),
}


QUICK = ("tight at the motor",)
NAMES = [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in UNEVEN]


@cache
def uneven(name):
    return record(UNEVEN[name], 0.2, 20.0, 0.2, 20.0)


@cache
def found(name):
    """A calibration, the paper's with the true EA and L."""
    sheath = UNEVEN[name]
    known = {"axial_stiffness": sheath.axial_stiffness, "length": sheath.length}
    return calibrate(*measured(uneven(name), 0), **known)


@pytest.mark.parametrize("name", NAMES)
def test_uneven_curvature_does_not_mislead(name):
    sheath, result = UNEVEN[name], found(name)
    assert abs(result.K.value - sheath.K) < max(3.0 * result.K.uncertainty, 0.01)
    assert abs(result.K.value - sheath.K) < 0.02
    stiffness = sheath.axial_stiffness / sheath.length
    assert result.stiffness_per_length.value == pytest.approx(stiffness, rel=0.005)


def test_the_uniform_methods_fail_on_uneven_curvature_and_that_is_noticed():
    name = "tight at the motor"
    result = found(name)
    assert not result.uniform
    assert not result.agree
    for other in (result.K_loop, result.K_paper, result.K_paper_ratio):
        assert abs(other.value - UNEVEN[name].K) > 0.2


@pytest.mark.parametrize("name", NAMES)
def test_the_pattern_serves_as_a_model_on_motions_it_was_not_fitted_to(name):
    sheath = UNEVEN[name]
    model = found(name).build_sheath(sheath.length, friction=0.15)
    assert model.length == pytest.approx(sheath.length, rel=1e-4)
    chain = Chain(list(fine(sheath)), sheath.friction, sheath.axial_stiffness, beads=40)
    T_in = path(0.2, 18.0, 3.0, 12.0, 5.0, 9.0, 1.0, 15.0)[::3]
    truth = []
    for T in T_in:
        chain.move(Force(T), HELD)
        truth.append((chain.T_out, chain.elongation))
    T_out, elongation = np.array(truth).T
    table = build_tables(model)
    by_model = simulate_tensions(table, build_slack_profile(table), T_in)
    assert np.abs(by_model[0] - T_out).max() < 0.03 * T_out.max()
    assert np.abs(by_model[1] - elongation).max() < 0.004 * elongation.max()


@pytest.mark.slow
def test_stated_uncertainties_cover_the_truth(clean):
    cases = [(clean, UNIFORM)]
    cases += [(uneven(name), UNEVEN[name]) for name in ("three bends", "straight between")]
    errors = []
    for loop, sheath in cases:
        for seed in range(3):
            result = calibrate(*measured(loop, seed, 0.03))
            stiffness = sheath.axial_stiffness / sheath.length
            pairs = ((result.K, sheath.K), (result.stiffness_per_length, stiffness))
            errors.append([(m.value - truth) / m.uncertainty for m, truth in pairs])
    inside = (np.abs(errors) < 2.5).mean(axis=0)
    assert (inside > 0.8).all(), inside
    assert (np.std(errors, axis=0) > 0.15).all(), "uncertainties far too large cover nothing"


def test_a_load_cell_that_is_not_zeroed_is_found_out(clean):
    T, q = measured(clean, 0)
    zero = -0.03
    result = calibrate(T + zero, q)
    assert result.K.value == pytest.approx(1.0, abs=0.015)
    assert result.zero.value == pytest.approx(zero, abs=0.01)


def test_the_papers_own_ratio_takes_the_tension_at_the_start_for_elongation(result):
    assert result.K_paper.value == pytest.approx(1.0, abs=0.01)
    share = 1.0 - 0.2 / 20.0  # the first 0.2 N had been stretched already
    assert result.M_e.value == pytest.approx(share * result.M_pull.value, rel=0.01)
    assert result.K_paper_ratio.value > result.K_paper.value


def test_closed_form_solves_the_papers_equation():
    for K in (0.1, 0.5, 1.0, 2.0, 3.0):
        m = -math.expm1(-K) / K
        found = compute_friction_from_elongation(m * 1.5 / 9000.0, 9000.0, 1.5)
        assert math.exp(-found) == pytest.approx(1.0 - m * found, rel=1e-9)
        assert found == pytest.approx(K, rel=1e-6)


def refusal(T, q, **words):
    with pytest.raises(CalibrationError) as caught:
        calibrate(T, q, **words)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_refuses_what_cannot_carry_a_calibration(clean):
    T, q = measured(clean, 0)
    broken = T.copy()
    broken[7] = math.nan
    rest = np.random.default_rng(0).normal(0.0, 0.02, 500)
    cases = [
        ((T[:30], q[:30]), "30 samples, at least 80"),
        ((broken, q), "1 samples are not finite, the first at index 7"),
        ((T[:1200], q[:1200]), "no release after the pull"),
        ((T[1200:4000], q[1200:4000]), "no pull before the release"),
        ((T, q[:-1]), "rows of equal length"),
        ((3.0 + rest, np.zeros(500)), "tension never rises"),
        ((3.0 + rest, np.linspace(0.0, 1e-3, 500)), "tension never rises"),
    ]
    for data, message in cases:
        assert message in refusal(*data)
    assert "needs both" in refusal(T, q, axial_stiffness=9000.0)


@pytest.mark.slow
def test_refuses_a_release_that_stays_inside_the_backlash():
    # the whole tendon slides below 20 e^-2 = 2.7 N
    message = refusal(*measured(record(UNIFORM, 0.2, 20.0, 3.0, 20.0), 0))
    assert "release further" in message


def test_refuses_a_saturated_load_cell(clean):
    T, q = measured(clean, 0)
    assert "saturated" in refusal(np.minimum(T, 17.0), q)


def test_refuses_a_tip_that_gives_way():
    soft = record(UNIFORM, 0.2, 20.0, 0.2, 20.0, tip=Spring(700.0))
    assert "not blocked" in refusal(*measured(soft, 0))


@pytest.mark.slow
def test_refuses_a_tip_that_touches_something_soft_before_its_stop(clean):
    """A tip that yields ever less as it is pulled harder, by F = k x^1.5."""
    T, q = clean
    table = build_tables(UNIFORM)
    T_out, _ = simulate_tensions(table, build_slack_profile(table), T)
    message = refusal(*measured((T, q + 1e-3 * (T_out / 5.0) ** (1 / 1.5)), 0))
    assert "tip gives way" in message or "tip moves" in message


def test_refuses_travel_that_has_nothing_to_do_with_tension(clean):
    T, q = measured(clean, 0)
    wander = 2e-4 * np.sin(np.linspace(0.0, 25.0, len(q)))
    message = refusal(T, q + wander)
    assert "describe this loop" in message or "decides K" in message


@pytest.mark.slow
def test_friction_that_depends_on_direction_is_noticed():
    result = calibrate(*measured(record(UNIFORM, 0.2, 20.0, 0.2, 20.0, asymmetry=1.3), 0))
    assert not result.uniform or result.misfit > 1.5


@pytest.mark.parametrize("releases", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_a_sheath_is_told_from_stretches_and_a_stop_behind_it(releases):
    """A tendon that goes on past two guides of an arm, to a joint at a stop that yields."""
    guides = [Section(1e-6, 1e-6 * 0.16 / friction) for friction in (0.15, 0.25)]
    in_arm = (guides[0], Section(0.06), guides[1], Section(0.03 + 0.01))
    sheath = Sheath((Section(0.6), Section(0.9, 0.9 * 0.16 / 0.7), *in_arm), 0.16, 9000.0)
    T, q = measured(record(sheath, 0.2, *[20.0, 0.2] * releases), 3)
    tail = Tail((0.06 / 1.5, 0.03 / 1.5), (0.15, 0.4), (0.0, 1.0))
    alone, found = calibrate(T, q), calibrate(T, q, tail=tail)
    assert alone.K.value > 0.8
    assert abs(found.K.value - 0.7) < 2.0 * max(found.K.uncertainty, 0.005)
    assert found.K.uncertainty < 0.03
    assert found.stiffness_per_length.value == pytest.approx(6000.0, rel=0.004)
    assert found.pattern.stop == pytest.approx(0.01 / 9000.0, rel=0.3)


def test_friction_of_guides_that_is_not_quite_the_known_one_is_not_taken_for_a_bend_of_the_sheath():
    """A tendon along a curved section of an arm, bent evenly, to a joint behind it."""
    section, bend = Section(0.06, 0.06 * 0.16 / 0.25), Section(0.5, 0.5 * 0.16 / 0.35)
    T, q = measured(
        record(Sheath((Section(0.6), bend, section, Section(0.04)), 0.16, 9000.0), 1.0, 20.0, 1.0),
        3,
    )
    share, depth = (
        (0.06 / 8 / 1.1,) * 8 + (0.04 / 1.1,),
        np.append(np.arange(0.5, 8) / 8, 1.0) * 0.23,
    )
    tail = Tail(share, tuple(depth.tolist()), (0.0,) * 9)
    exact, found = calibrate(T, q, tail=tail), calibrate(T, q, tail=tail._replace(error=0.08))
    assert len(found.pattern.ends) == 1 < len(exact.pattern.ends)
    assert abs(exact.K.value - 0.35) > 4.0 * exact.K.uncertainty
    assert abs(found.K.value - 0.35) < 2.0 * found.K.uncertainty < 0.003
    assert found.stiffness_per_length.value == pytest.approx(9000.0 / 1.1, rel=0.002)
