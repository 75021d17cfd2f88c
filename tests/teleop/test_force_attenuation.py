"""Attenuation of an estimate by its interval."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from estimator.online import online
from estimator.online.estimator_state import BOUND_SIGMAS
from estimator.structs import to_struct
from studies.adaptation import UNCHANGED, simulate_use
from teleop.coupling.force_attenuation import (
    MARGIN_MIN,
    ConfidenceConfig,
    attenuate_force,
    attenuate_forces,
    find_smallest_force,
)

FORCES = st.floats(-100.0, 100.0)
RULES = st.builds(
    lambda full, more: to_struct(ConfidenceConfig(full, full + more)),
    st.floats(0.0, 5.0),
    st.floats(0.01, 5.0),
)
RULE = to_struct(ConfidenceConfig())
FINE = (1.0, 0.9, 1.1, 0.0)
MARGINS = st.one_of(st.just(0.0), st.floats(0.0, 100.0))


@given(RULES, FORCES, FORCES, FORCES, MARGINS)
def test_never_stronger_than_the_estimate_never_of_the_other_sign_never_weaker_than_is_certain(
    rule, force, one, other, margin
):
    low, high = min(one, other), max(one, other)
    felt, certain = attenuate_force(rule, force, low, high, margin), find_smallest_force(low, high)
    assert abs(felt) <= abs(force)
    assert felt * force >= 0.0
    if low <= force <= high:
        assert abs(felt) >= abs(certain) - 1e-12
        assert abs(felt) <= max(abs(force) - margin, abs(certain)) + 1e-12


@given(FORCES, FORCES, FORCES, MARGINS)
def test_without_a_margin_both_ends_count_and_with_one_the_end_towards_zero(
    force, below, above, margin
):
    low, high = force - abs(below), force + abs(above)
    margin = max(margin, 1.01 * MARGIN_MIN * abs(force))
    ends = (low, high + 50.0) if force > 0.0 else (low - 50.0, high)
    felt = attenuate_force(RULE, force, low, high, margin)
    assert attenuate_force(RULE, force, *ends, margin) == felt
    ends = (low - 50.0, high) if force > 0.0 else (low, high + 50.0)
    assert abs(attenuate_force(RULE, force, *ends, margin)) <= abs(felt)
    assert abs(attenuate_force(RULE, force, low - 50.0, high + 50.0, 0.0)) <= abs(
        attenuate_force(RULE, force, low, high, 0.0)
    )


@given(RULES, FORCES, st.floats(0.0, 100.0), st.floats(0.0, 100.0), MARGINS)
@example(RULE, 20.0, 20.0, 0.0, 0.0)
def test_an_estimate_at_the_far_end_of_its_interval_is_rendered_as_one_in_the_middle(
    rule, force, towards_zero, beyond, margin
):
    ends = sorted(force - math.copysign(d, force) for d in (towards_zero, -beyond))
    middle = force - towards_zero, force + towards_zero
    felt = abs(attenuate_force(rule, force, *ends, margin))
    assert felt <= abs(attenuate_force(rule, force, *middle, margin)) + 1e-9


@given(
    RULES,
    FORCES,
    st.floats(0.0, 100.0),
    st.floats(0.0, 100.0),
    MARGINS,
    st.tuples(*[st.floats(-1, 1)] * 4),
)
def test_it_is_continuous_in_the_force_and_in_both_ends_and_in_the_margin(
    rule, force, below, above, margin, nudge
):
    low, high = force - below, force + above
    felt = attenuate_force(rule, force, low, high, margin)
    for size in (1e-3, 1e-6, 1e-9):
        df, dl, dh, dm = (size * n for n in nudge)
        ends = min(low + dl, high + dh), max(low + dl, high + dh)
        near = attenuate_force(rule, force + df, *ends, max(margin + dm, 0.0))
        # w changes by at most (half-width / f^2) / (none - full) per newton, times |f - c| <= |f|;
        # from both ends to one within `MARGIN_MIN` |f|
        steep = 2.0 + 4.0 * (rule.none + 1.0) / (rule.none - rule.full) + 2.0 / MARGIN_MIN
        assert abs(near - felt) <= steep * size * 4.0


def test_the_rule_in_numbers():
    rule = to_struct(ConfidenceConfig(full=0.5, none=1.5))
    assert attenuate_force(rule, 10.0, 5.0, 15.0, 0.0) == 10.0
    assert attenuate_force(rule, 10.0, 0.0, 20.0, 0.0) == pytest.approx(5.0)
    assert attenuate_force(rule, 10.0, -5.0, 25.0, 0.0) == 0.0
    assert attenuate_force(rule, 4.0, 3.0, 23.0, 0.0) == 3.0  # far too wide: what is certain
    assert attenuate_force(rule, -10.0, -20.0, 0.0, 0.0) == pytest.approx(-5.0)
    assert attenuate_force(rule, 20.0, 0.0, 20.0, 0.0) == pytest.approx(10.0)


@pytest.mark.parametrize("ends", [(1.0, -1.0), (math.nan, 1.0), (1.0, math.nan)])
def test_an_interval_that_is_none_certifies_nothing(ends):
    assert attenuate_force(RULE, 5.0, *ends, 0.0) == 0.0


@given(FORCES, st.sampled_from([math.inf, 1e308]), st.sampled_from([0.0, math.inf]))
def test_an_interval_without_end_leaves_what_is_certain(force, end, margin):
    assert attenuate_force(RULE, force, -end, end, 1.0) == 0.0
    assert attenuate_force(RULE, abs(force) + 1.0, 1.0, end, margin) == 1.0


@given(st.lists(st.tuples(*[st.one_of(FORCES, st.floats(width=32))] * 4), min_size=5, max_size=5))
@example([FINE, (3.0, 2.0, 4.0, 0.0), (0.0, 5.0, -5.0, 0.0), FINE, FINE])
@example([FINE, (3.0, 2.0, 4.0, -1.0), FINE, FINE, (2.0, 1.0, 3.0, math.nan)])
@example([FINE, (3.0, 9.0, -9.0, 0.0), FINE, FINE, (0.0, 2.0, 2.0, 0.0)])
@example([FINE, (3.0, 2.0, 4.0, 0.5), FINE, (0.0, 0.9, math.nan, 0.0), FINE])
def test_whatever_the_estimates_an_arm_is_attenuated_as_one_or_not_at_all(rows):
    """Joints 1 and 2 are an arm, 3 and 4 another."""
    estimates, felt = np.array(rows).T.copy(), np.full(5, 99.0)
    attenuate_forces(RULE, np.array([-1, 0, 0, 1, 1]), estimates, 5, 0.0, felt)
    assert felt[0] == attenuate_force(RULE, *rows[0]) or math.isnan(rows[0][0])
    for first in (1, 3):
        force, low, high, margin = estimates[:, first : first + 2]
        out = felt[first : first + 2]
        if not np.isfinite(force).all():
            assert not np.isfinite(out).all()
        elif not ((low <= high) & (margin >= 0.0)).all():
            assert not out.any()
        else:
            assert (np.abs(out) <= np.abs(force)).all()
            assert (out * force >= 0.0).all()


@pytest.mark.parametrize("seed", range(100, 112))
def test_with_any_k_of_its_interval_the_hand_gets_no_more_than_the_tip_of_a_plant(seed):
    """K of the model is wrong; its interval, wide or narrow, holds that of the chain of nodes."""
    rng = np.random.default_rng([seed, 2])
    given = UNCHANGED._replace(settle=0.0, after=5.0, model_error=rng.uniform(-0.35, 0.5))
    use = simulate_use(seed, pair=False, given=given)
    (model,), (true_K,) = use.models, use.K_after
    low, high = min(model.sheath.K, true_K), max(model.sheath.K, true_K)
    prepared = online.prepare(model)
    prepared.K_below = model.sheath.K - rng.uniform(0.8, 1.0) * low
    prepared.K_above = rng.uniform(1.0, 1.2) * high - model.sheath.K
    run = online.run(prepared, use.time, use.tension[:, 0], use.travel[:, 0])
    margin, tip = run.distal_tension - run.adapted_low, use.tip[:, 0]
    rows = zip(run.distal_tension, run.low, run.high, margin, strict=True)
    felt = np.array([attenuate_force(RULE, *row) for row in rows])
    noise = BOUND_SIGMAS * model.tension_noise * math.exp(true_K)  # of a tendon that is released
    assert (felt <= tip + noise).all()
    assert felt.sum() > 0.3 * tip.sum()
    if true_K > 1.1 * model.sheath.K:
        unaware = [attenuate_force(RULE, *row, 0.0) for row in zip(*run[:3], strict=True)]
        assert (unaware > tip + noise).any()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_force_that_is_no_number_is_not_turned_into_one(bad):
    assert not math.isfinite(attenuate_force(RULE, bad, -1.0, 1.0, 0.0))


@pytest.mark.parametrize(
    "wrong", [{"full": math.nan}, {"none": 0.5}, {"none": math.inf}, {"full": 2.0}]
)
def test_bad_values_are_refused(wrong):
    with pytest.raises(ValueError, match=r"full|none"):
        ConfidenceConfig(**wrong)
