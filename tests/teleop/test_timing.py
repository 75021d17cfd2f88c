import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from teleop.runtime.clock import Durations, Span


@given(st.lists(st.integers(0, 99_000_000), min_size=1, max_size=300), st.floats(0.0, 100.0))
def test_percentiles_are_those_of_the_values_to_a_bin(values, percent):
    durations = Durations()
    for value in values:
        durations.add(value)
    truth = np.percentile(values, percent, method="higher")
    lower = np.percentile(values, percent, method="lower")
    assert lower - 1000 < durations.compute_percentile_ns(percent) <= truth
    assert durations.compute_percentiles(1.0).n == len(values)


def test_absurd_durations_are_counted_and_not_lost():
    durations = Durations()
    for value in (-5, 10**12):
        durations.add(value)
    assert durations.compute_percentiles(1.0).n == 2
    assert durations.compute_percentile_ns(0.0) == 0
    assert durations.compute_percentile_ns(100.0) == 2_000_000_000


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=300))
def test_a_span_is_of_all_that_came_and_its_percentiles_are_among_it(values):
    durations = Durations()
    for value in values:
        durations.add(value)
    span = durations.take_span()
    assert span.values == len(values)
    assert span.largest == max(values)
    assert min(values) <= span.p50 <= span.p99 <= span.p99_9 <= span.largest
    assert set(span[1:]) <= set(values)
    assert sum(value < span.p50 for value in values) <= len(values) / 2
    assert sum(value > span.p50 for value in values) <= len(values) / 2
    assert durations.take_span() == Span()  # of what came since
    assert durations.compute_percentiles(1.0).n == len(values)
