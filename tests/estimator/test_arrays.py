import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from estimator import arrays

NUMBERS = st.floats(-1e6, 1e6)


@given(st.lists(NUMBERS, min_size=1, max_size=99))
def test_the_median_is_numpys(numbers):
    assert arrays.compute_median(np.array(numbers)) == np.median(numbers)


@given(
    st.lists(st.integers(-99, 99).map(float), min_size=2, max_size=61).map(sorted),
    st.data(),
    st.floats(-120.0, 120.0) | st.integers(-120, 120).map(float) | st.just(np.nan),
)
def test_interpolation_is_numpys_to_the_last_bit(places, data, x):
    values = data.draw(st.lists(NUMBERS, min_size=len(places), max_size=len(places)))
    found = arrays.interpolate(x, np.array(places), np.array(values))
    np.testing.assert_equal(found, np.interp(x, places, values))
