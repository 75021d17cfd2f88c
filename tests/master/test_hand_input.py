"""Hands as records: what a device returned, and nothing of the hand before."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from estimator.records import view_struct
from master.device import HandState
from master.hand_input import HandInput, fill_hand_input, is_all_finite
from teleop.messages.messages import MAX_JOINTS
from tests.master.records import eight

ANY = st.floats(allow_nan=True, allow_infinity=True)
AXES = st.integers(1, MAX_JOINTS).flatmap(lambda n: st.tuples(*[st.tuples(*[ANY] * n)] * 2))
HANDS = st.none() | st.builds(
    lambda axes, *flags: HandState(*axes, *flags), AXES, st.booleans(), st.booleans(), st.booleans()
)


@given(st.lists(HANDS, min_size=1, max_size=3))
def test_a_record_has_all_of_the_last_hand_and_nothing_of_one_before(hands):
    records = HandInput.array()
    for hand in hands:
        fill_hand_input(records, hand)
    record = view_struct(records)
    assert bool(record.present) == (hand is not None)
    if hand is None:
        assert records.tobytes() == HandInput.array().tobytes()
        return
    axes = len(hand.position)
    assert record.axes == axes
    for field in ("position", "velocity"):
        np.testing.assert_array_equal(record[field][:axes], getattr(hand, field))
        assert not record[field][axes:].any()
    flags = (hand.engage, hand.clutch, hand.stop)
    assert (record.engage, record.clutch, record.stop) == flags


@given(st.lists(ANY, max_size=MAX_JOINTS))
def test_only_the_axes_in_use_must_be_finite(values):
    for axes in range(len(values) + 1):
        assert is_all_finite(eight(*values), axes) == all(map(math.isfinite, values[:axes]))
