"""Weighing what patterns may be, alone and by pairs, on rivals made up by hand."""

import pytest

from estimator.calibration.model_averaging import Rival, average_antagonists, average_rivals
from estimator.calibration.pattern import Pattern
from estimator.fitting import MeasuredValue


def rival(K, score, uncertainty=0.002):
    """Return a bend to 0.5 and another one to K."""
    return Rival(Pattern((0.5, K), (1e-4, 1e-5), (0.0, 0.0, 0.0)), score, uncertainty)


MISTAKEN = (rival(0.95, 0.0), rival(1.0, 1.0))
SURE = (rival(1.2, 0.0),)


def test_the_total_decides_between_rivals_that_a_loop_cannot_tell_apart():
    assert average_rivals(MISTAKEN).K.value == 0.95
    a, b = average_antagonists(MISTAKEN, SURE, MeasuredValue(2.2, 0.003))
    assert a.K.value == pytest.approx(1.0, abs=1e-3)
    assert b.K.value == pytest.approx(1.2, abs=1e-3)
    assert a.K.uncertainty < average_rivals(MISTAKEN).K.uncertainty


def test_who_comes_first_does_not_matter():
    total = MeasuredValue(2.19, 0.003)
    assert (
        average_antagonists(MISTAKEN, SURE, total)
        == average_antagonists(SURE, MISTAKEN, total)[::-1]
    )


def test_what_is_missing_goes_to_the_one_that_is_less_sure():
    unsure, sure = (rival(1.0, 0.0, 0.03),), (rival(1.0, 0.0, 0.002),)
    a, b = average_antagonists(unsure, sure, MeasuredValue(2.04, 1e-4))
    assert a.K.value + b.K.value == pytest.approx(2.04, abs=1e-3)
    assert a.K.value - 1.0 > 5.0 * (b.K.value - 1.0) > 0.0


def test_what_is_put_right_is_the_last_bend():
    (a, _) = average_antagonists((rival(1.0, 0.0),), (rival(1.0, 0.0),), MeasuredValue(2.02, 1e-4))
    assert a.pattern.ends[0] == 0.5
    assert a.K.value == pytest.approx(a.pattern.K)
    assert a.pattern.compliance == rival(1.0, 0.0).pattern.compliance


def test_a_last_bend_that_cannot_give_so_much_leaves_it_to_all():
    pattern = Pattern((0.99, 1.0), (1e-4, 1e-5), (0.0, 0.0, 0.0)).adjust_friction(0.9)
    assert pytest.approx((0.891, 0.9)) == pattern.ends
