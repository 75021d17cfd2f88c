import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from estimator.law.sheath import MAX_K, Section, Sheath, SheathError
from estimator.law.tables import (
    K,
    build_tables,
    compute_arc_length,
    compute_friction_coordinate,
    integrate_exponential,
)

SECTIONS = st.lists(
    st.builds(Section, st.floats(0.01, 1.0), st.one_of(st.just(math.inf), st.floats(0.02, 2.0))),
    min_size=1,
    max_size=6,
).map(tuple)


def sheaths():
    return st.builds(
        Sheath,
        SECTIONS,
        st.one_of(st.just(0.0), st.floats(0.01, 0.2)),
        st.just(9000.0),
        st.just(0.0),
        st.floats(0.5, 1.6),
    ).filter(lambda sheath: sheath.K < 5)


def along(sheath, x):
    """Return s(x) by adding up what of each section lies before `x`."""
    s, start = 0.0, 0.0
    for section in sheath.sections:
        s += sheath.friction * min(max(x - start, 0.0), section.length) / section.radius
        start += section.length
    return s


@settings(deadline=None)
@given(sheaths(), st.floats(0.0, 1.0), st.sampled_from([-1, 0, 1]))
def test_integrals_are_the_areas_they_name(sheath, fraction, direction):
    slope = {-1: -1.0, 0: 0.0, 1: sheath.asymmetry}[direction]
    table = build_tables(sheath)
    s_end = fraction * table[K]
    area, start = 0.0, 0.0
    for section in sheath.sections:
        x = start + section.length * np.linspace(0.0, 1.0, 201)
        s = np.array([along(sheath, v) for v in x])
        if s[-1] - s[0] < 1e-9:  # a straight section counts as a whole, or not
            assume(fraction in (0.0, 1.0) or abs(s[0] - s_end) > 1e-8)
            area += section.length * math.exp(slope * s[0]) * (s[0] <= s_end + 1e-9)
        else:
            s, x = np.minimum(s, s_end), np.interp(np.minimum(s, s_end), s, x)
            area += np.trapezoid(np.exp(slope * s), x)
        start += section.length
    assert integrate_exponential(table, s_end, slope) == pytest.approx(area, rel=1e-4)


@settings(deadline=None)
@given(sheaths(), st.floats(0.0, 1.0))
def test_coordinates_invert_each_other(sheath, fraction):
    table = build_tables(sheath)
    x = fraction * sheath.length
    assert compute_friction_coordinate(table, x) == pytest.approx(along(sheath, x), abs=1e-7)
    s = fraction * table[K]
    assert compute_friction_coordinate(table, compute_arc_length(table, s)) == pytest.approx(
        s, abs=1e-7
    )


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: Section(0.0), "length"),
        (lambda: Section(math.nan), "length"),
        (lambda: Section(1.0, 0.0), "radius"),
        (lambda: Sheath((), 0.1, 9000.0), "sections"),
        (lambda: Sheath((Section(1.0),), -0.1, 9000.0), "friction"),
        (lambda: Sheath((Section(1.0),), 0.1, 9000.0, drag=-1.0), "drag"),
        (lambda: Sheath((Section(1.0),), 0.1, 9000.0, asymmetry=0.0), "asymmetry"),
        (lambda: Sheath.uniform(1.0, 1.0, 9000.0, friction=0.0), "friction"),
        (lambda: Sheath.uniform(1.01 * MAX_K, 1.0, 9000.0), "K"),
    ],
)
def test_an_impossible_sheath_is_refused_by_name(make, word):
    with pytest.raises(SheathError, match=word) as caught:
        make()
    assert "\n" not in str(caught.value)
