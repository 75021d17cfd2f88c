import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba.core.caching import NullCache

from estimator import small_arrays
from estimator.compiled import jit_compile

NUMBERS = st.floats(-1e6, 1e6)


@given(st.lists(NUMBERS, min_size=1, max_size=99))
def test_the_median_is_numpys(numbers):
    assert small_arrays.compute_median(np.array(numbers)) == np.median(numbers)


@given(
    st.lists(st.integers(-99, 99).map(float), min_size=2, max_size=61).map(sorted),
    st.data(),
    st.floats(-120.0, 120.0) | st.integers(-120, 120).map(float) | st.just(np.nan),
)
def test_interpolation_is_numpys_to_the_last_bit(places, data, x):
    values = data.draw(st.lists(NUMBERS, min_size=len(places), max_size=len(places)))
    found = small_arrays.interpolate(x, np.array(places), np.array(values))
    np.testing.assert_equal(found, np.interp(x, places, values))


@jit_compile
def weigh(values, weight=1.0, backwards=False):
    first = len(values) - 1 if backwards else 0
    return values[first] + weight * values[1]


@jit_compile
def weigh_all(record, values):
    return weigh(record.x, 1), weigh(record.x, weight=2, backwards=True), weigh(values, 3)


def test_a_records_array_and_a_literal_need_no_version_of_their_own():
    """To numba they are types of their own, for which all that is called is compiled once more."""
    records = np.zeros(2, np.dtype([("x", float, 3), ("y", float)], align=True))
    records["x"] = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    weigh_all._cache = weigh.part._cache = NullCache()  # a cached caller compiles none of its parts
    found = weigh_all(records[1], np.array([7.0, 8.0]))
    assert found == (9.0, 16.0, 31.0)
    assert len({str(signature[0]) for signature in weigh.part.signatures}) == 1
    assert {str(signature[1]) for signature in weigh.part.signatures} == {"int64"}


@jit_compile
def write_slice(target, source):
    target[1:3] = source


def test_a_slice_takes_no_array_of_another_shape():
    target = np.zeros(4)
    with pytest.raises(ValueError, match="a slice of another shape"):
        write_slice(target, np.ones(3))
    write_slice(target, np.ones(2))
    assert target.tolist() == [0.0, 1.0, 1.0, 0.0]
