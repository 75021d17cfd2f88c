"""Attenuation of an estimate by its interval."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from estimator.structs import to_struct
from teleop.coupling.force_attenuation import (
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


@given(RULES, FORCES, FORCES, FORCES)
def test_never_stronger_than_the_estimate_never_of_the_other_sign_never_weaker_than_is_certain(
    rule, force, one, other
):
    low, high = min(one, other), max(one, other)
    felt = attenuate_force(rule, force, low, high)
    assert abs(felt) <= abs(force)
    assert felt * force >= 0.0
    if low <= force <= high:
        assert abs(felt) >= abs(find_smallest_force(low, high)) - 1e-12


@given(
    RULES, FORCES, st.floats(0.0, 100.0), st.floats(0.0, 100.0), st.tuples(*[st.floats(-1, 1)] * 3)
)
def test_it_is_continuous_in_the_force_and_in_both_ends(rule, force, below, above, nudge):
    low, high = force - below, force + above
    felt = attenuate_force(rule, force, low, high)
    for size in (1e-3, 1e-6, 1e-9):
        df, dl, dh = (size * n for n in nudge)
        near = attenuate_force(rule, force + df, min(low + dl, high + dh), max(low + dl, high + dh))
        # w changes by at most (half-width / f^2) / (none - full) per newton, times |f - c| <= |f|
        steep = 2.0 + 4.0 * (rule.none + 1.0) / (rule.none - rule.full)
        assert abs(near - felt) <= steep * size * 3.0


def test_the_rule_in_numbers():
    rule = to_struct(ConfidenceConfig(full=0.5, none=1.5))
    assert attenuate_force(rule, 10.0, 5.0, 15.0) == 10.0
    assert attenuate_force(rule, 10.0, 0.0, 20.0) == pytest.approx(5.0)
    assert attenuate_force(rule, 10.0, -5.0, 25.0) == 0.0
    assert attenuate_force(rule, 4.0, 3.0, 23.0) == 3.0  # far too wide: what is certain
    assert attenuate_force(rule, -10.0, -20.0, 0.0) == pytest.approx(-5.0)


@pytest.mark.parametrize("ends", [(1.0, -1.0), (math.nan, 1.0), (1.0, math.nan)])
def test_an_interval_that_is_none_certifies_nothing(ends):
    assert attenuate_force(RULE, 5.0, *ends) == 0.0


@given(FORCES, st.sampled_from([math.inf, 1e308]))
def test_an_interval_without_end_leaves_what_is_certain(force, end):
    assert attenuate_force(RULE, force, -end, end) == 0.0
    assert attenuate_force(RULE, abs(force) + 1.0, 1.0, end) == 1.0


@given(st.lists(st.tuples(*[st.one_of(FORCES, st.floats(width=32))] * 3), min_size=5, max_size=5))
@example([(0.0, 1.0, 1.0), (3.0, 2.0, 4.0), (0.0, 5.0, -5.0), (1.0, 0.9, 1.1), (2.0, 2.0, 2.0)])
@example([(0.0, 1.0, 1.0), (3.0, 9.0, -9.0), (9.0, 8.0, 10.0), (1.0, 0.9, 1.1), (0.0, 2.0, 2.0)])
@example([(0.0, 1.0, 1.0), (3.0, 2.0, 4.0), (1.0, 1.0, 1.0), (0.0, 0.9, math.nan), (2.0, 2.0, 2.0)])
def test_whatever_the_estimates_an_arm_is_attenuated_as_one_or_not_at_all(rows):
    """Joints 1 and 2 are an arm, 3 and 4 another."""
    estimates, felt = np.array(rows).T.copy(), np.full(5, 99.0)
    attenuate_forces(RULE, np.array([-1, 0, 0, 1, 1]), estimates, 5, 0.0, felt)
    assert felt[0] == attenuate_force(RULE, *rows[0]) or math.isnan(rows[0][0])
    for first in (1, 3):
        force, low, high = estimates[:, first : first + 2]
        out = felt[first : first + 2]
        if not np.isfinite(force).all():
            assert not np.isfinite(out).all()
        elif not (low <= high).all():
            assert not out.any()
        else:
            assert (np.abs(out) <= np.abs(force)).all()
            assert (out * force >= 0.0).all()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_force_that_is_no_number_is_not_turned_into_one(bad):
    assert not math.isfinite(attenuate_force(RULE, bad, -1.0, 1.0))


@pytest.mark.parametrize(
    "wrong", [{"full": math.nan}, {"none": 0.5}, {"none": math.inf}, {"full": 2.0}]
)
def test_bad_values_are_refused(wrong):
    with pytest.raises(ValueError, match=r"full|none"):
        ConfidenceConfig(**wrong)
