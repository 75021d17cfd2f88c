import math

import numpy as np
import pytest
import rerun as rr
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.messages.messages import PROFILE_POINTS, MessageError
from teleop.messages.topics import TENDONS
from teleop.view.colours import UNKNOWN, to_rgba
from teleop.view.columns import build_columns, decode, subsample_rows
from teleop.view.scene_geometry import compute_centreline
from teleop.view.scene_sheaths import compute_friction_profile, compute_tension_band
from tests.teleop.view.made_session import T0

# decoding and thinning


def test_messages_of_another_layout_are_refused(session):
    topic, data = session.messages[0]
    damaged = data[:8] + b"\xff\xff\xff\xff" + data[12:]
    for foreign in (damaged, data[:-8], data + bytes(8)):
        with pytest.raises(MessageError):
            decode([(topic, data), (topic, foreign)])


def rows_at(stamps):
    rows = np.zeros(len(stamps), TENDONS.message.schema.dtype)
    rows["stamp_ns"] = stamps
    return rows


@given(
    steps=st.lists(st.integers(1, 30_000_000), min_size=1, max_size=200),
    rate=st.floats(1, 1000),
    cuts=st.integers(1, 5),
)
def test_thinning_keeps_the_newest_and_the_rate(steps, rate, cuts):
    stamps = T0 + np.cumsum(steps)
    for block in np.array_split(stamps, cuts):
        kept = subsample_rows(rows_at(block), rate)["stamp_ns"]
        assert len(kept) <= len(block)
        if len(block):
            assert kept[-1] == block[-1]
            assert len(kept) <= (block[-1] - block[0]) * rate * 1e-9 + 2
            # whatever is hidden is followed within a period by something shown
            assert all(np.diff(kept) <= np.diff(block).max(initial=0) + 1e9 / rate + 1)


# columns

POINTS = np.arange(18.0).reshape(6, 3)
COUNTS = [2, 0, 1, 3]
LINES = [POINTS[:2], POINTS[2:3], POINTS[2:], POINTS, POINTS[1:3], POINTS[::-1]]


@pytest.mark.parametrize(
    ("archetype", "fields"),
    [
        (rr.Scalars, {"scalars": POINTS[:, 0]}),
        (rr.Points3D, {"positions": POINTS, "labels": list("abcdef")}),
        (rr.Arrows3D, {"origins": POINTS, "vectors": -POINTS}),
        (rr.Capsules3D, {"colors": np.arange(6, dtype=np.uint32), "radii": POINTS[:, 1]}),
        (rr.LineStrips2D, {"strips": [line[:, :2] for line in LINES]}),
    ],
)
def test_columns_are_those_of_the_archetype_itself(archetype, fields):
    made, known = (
        {str(column.component_descriptor()): column.as_arrow_array() for column in some}
        for some in (
            build_columns(archetype, COUNTS, **fields),
            archetype.columns(**fields).partition(COUNTS),
        )
    )
    assert made == known


def test_tensions_off_the_scale_take_its_ends_and_unknown_ones_grey():
    colours = to_rgba(np.array([-1.0, 0.0, 20.0, 1e9, math.nan, math.inf]), 20.0)
    assert colours[0] == colours[1]
    assert colours[2] == colours[3]
    assert colours[4] == colours[5] == UNKNOWN
    assert (colours & 0xFF == 0xFF).all()


@settings(max_examples=20)
@given(
    sections=st.lists(
        st.tuples(
            st.floats(0.01, 1.0),
            st.one_of(st.just(math.inf), st.floats(0.03, 2), st.floats(-2, -0.03)),
        ),
        min_size=1,
        max_size=6,
    ),
    gap=st.floats(0, 0.05),
)
def test_the_drawn_sheath_has_the_length_and_the_bends_of_the_real_one(sections, gap):
    length, radius = np.array(sections).T
    s = np.linspace(0, length.sum(), 20_001)
    line = compute_centreline(length, radius, s, gap).points
    chords = np.diff(line, axis=0)
    pieces = np.linalg.norm(chords, axis=1)
    # a chord is shorter than its arc by (angle per piece)^2 / 24, under 1e-6 here
    assert pieces.sum() == pytest.approx(length.sum(), rel=1e-5)
    assert pieces.max() < 1.001 * s[1]  # and there are no jumps
    heading = np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]))
    # nor kinks where sections meet
    assert np.abs(np.diff(heading)).max() <= 1.01 * s[1] / np.abs(radius).min() + 1e-6
    ends = np.cumsum(length)
    middle = (s[1:] + s[:-1]) / 2
    for begin, end, l_k, r_k in zip(ends - length, ends, length, radius, strict=True):
        inside = heading[(middle > begin + 2 * s[1]) & (middle < end - 2 * s[1])]
        assert inside[-1] - inside[0] == pytest.approx(l_k / r_k, abs=6 * s[1] / abs(r_k) + 1e-6)


# what slides, and what is certain


@given(
    K=st.floats(0, 2),
    steps=st.lists(st.floats(-1, 1), min_size=64, max_size=64),
    T_in=st.floats(0.1, 20),
    wide=st.floats(0, 3),
)
def test_whatever_profile_friction_allows_lies_within_the_band(K, steps, T_in, wide):
    length, radius = np.array([0.3, 0.5, 0.2]), np.array([math.inf, 0.2, 0.1])
    k = compute_friction_profile(length, radius, K, PROFILE_POINTS)
    assert k[0] == 0
    assert k[-1] == pytest.approx(K)
    T = T_in * np.exp(np.concatenate([[0], np.cumsum(np.array(steps) * np.diff(k))]))
    ends = np.array([T[-1] * math.exp(-wide)]), np.array([T[-1] * math.exp(wide)])
    low, high = compute_tension_band(k, T[:1], *ends)
    assert (low[0] <= T * (1 + 1e-9)).all()
    assert (high[0] * (1 + 1e-9) >= T).all()
    assert low[0, 0] <= T_in * (1 + 1e-9)
