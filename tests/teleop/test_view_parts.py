import math
from itertools import combinations

import numpy as np
import pytest
import rerun as rr
from hypothesis import given
from hypothesis import strategies as st

from teleop.messages.messages import PROFILE_POINTS, MessageError
from teleop.messages.topics import TENDONS
from teleop.view.colours import BACKGROUND as DARK
from teleop.view.colours import UNKNOWN, to_rgba
from teleop.view.columns import Stamps, build_columns, decode, subsample_rows
from teleop.view.config import ViewConfig
from teleop.view.profile_plot import Plane, compute_ticks
from teleop.view.scene import find_sliding_segments, interpolate_line
from teleop.view.scene_geometry import (
    EYE,
    UP,
    Shape,
    build_stage,
    compute_centreline,
    compute_rotations_from_z,
)
from teleop.view.sheaths import compute_friction_profile, compute_tension_band
from tests.teleop.view_session import T0, Session


@pytest.fixture(scope="module")
def session():
    return Session()


# decoding and thinning


def test_a_batch_decodes_as_message_by_message(session):
    batches = decode(session.messages)
    for topic, rows in batches.items():
        expected = session.of(topic)
        assert len(rows) == len(expected)
        for name in topic.message.schema.dtype.names:
            values = np.array([getattr(message, name) for message in expected])
            np.testing.assert_array_equal(rows[name], values, err_msg=f"{topic.name}.{name}")


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


def test_a_thousand_a_second_become_a_hundred(session):
    rows = decode(session.messages)[TENDONS]
    assert len(subsample_rows(rows, 100)) == pytest.approx(100, abs=2)
    assert len(subsample_rows(rows, 1000)) == len(rows)


# columns

POINTS = np.arange(18.0).reshape(6, 3)
COUNTS = [2, 0, 1, 3]
LINES = [POINTS[:2], POINTS[2:3], POINTS[2:], POINTS, POINTS[1:3], POINTS[::-1]]


@pytest.mark.parametrize(
    ("archetype", "fields"),
    [
        (rr.Scalars, {"scalars": POINTS[:, 0]}),
        (rr.Points3D, {"positions": POINTS, "labels": list("abcdef")}),
        (rr.Points2D, {"positions": POINTS[:, :2]}),
        (rr.Arrows3D, {"origins": POINTS, "vectors": -POINTS}),
        (rr.Capsules3D, {"colors": np.arange(6, dtype=np.uint32), "radii": POINTS[:, 1]}),
        (rr.LineStrips3D, {"strips": LINES}),
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
    assert {name: values.type for name, values in made.items()} == {
        name: values.type for name, values in known.items()
    }


def test_lines_of_as_many_points_can_be_stacked_and_a_row_has_one_value_by_default():
    stacked = POINTS.reshape(3, 2, 3)
    (made,) = build_columns(rr.LineStrips3D, strips=stacked)
    (known,) = build_columns(rr.LineStrips3D, [1, 1, 1], strips=list(stacked))
    assert made.as_arrow_array() == known.as_arrow_array()
    (nothing,) = build_columns(rr.LineStrips2D, [0, 0], strips=[])
    assert nothing.as_arrow_array().to_pylist() == [[], []]


def test_stamps_are_the_times_of_rows(session):
    stamps = decode(session.messages)[TENDONS]["stamp_ns"]
    known = rr.TimeColumn("time", timestamp=stamps.astype("datetime64[ns]"))
    assert Stamps(stamps).as_arrow_array() == known.as_arrow_array()
    assert Stamps(stamps).timeline_name() == known.timeline_name()


# colours

BACKGROUND = DARK[0] << 24 | DARK[1] << 16 | DARK[2] << 8 | 0xFF


def lightness(colour):
    """CIE L* of 0xRRGGBBAA, D65."""
    rgb = np.array([(colour >> shift) & 0xFF for shift in (24, 16, 8)]) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    y = linear @ [0.2126, 0.7152, 0.0722]
    return 116 * np.cbrt(y) - 16 if y > 0.008856 else 903.3 * y


def test_lightness_rises_evenly_with_tension():
    levels = np.array([lightness(int(c)) for c in to_rgba(np.linspace(0, 20, 81), 20.0)])
    steps = np.diff(levels)
    assert (steps > 0).all()
    assert levels[0] > lightness(BACKGROUND) + 35  # seen from 0 N on
    assert levels[-1] > 88
    assert steps.max() < 3 * steps.mean()


def test_tensions_off_the_scale_take_its_ends_and_unknown_ones_grey():
    colours = to_rgba(np.array([-1.0, 0.0, 20.0, 1e9, math.nan, math.inf]), 20.0)
    assert colours[0] == colours[1]
    assert colours[2] == colours[3]
    assert colours[4] == colours[5] == UNKNOWN
    assert (colours & 0xFF == 0xFF).all()


# shape


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


def test_a_coil_does_not_run_into_itself():
    line, *_ = compute_centreline(np.array([2.0]), np.array([0.1]), np.linspace(0, 2, 2001), 0.04)
    turn = round(2 * math.pi * 0.1 * 1000)
    assert np.linalg.norm(line[turn:] - line[:-turn], axis=1).min() > 0.039


# the plot


@given(st.floats(1e-3, 1e4))
def test_ticks_are_few_and_round(top):
    values = compute_ticks(top)
    assert 3 <= len(values) <= 9
    assert values[0] == 0
    assert values[-1] <= top * (1 + 1e-9) < values[-1] + values[1] * (1 + 1e-9)


def test_the_plane_is_linear_in_its_quantities():
    plane = Plane(0.8, 20.0, 1.8, "x [m]", "T [N]")
    corner = plane.points(np.array([0.0, 0.8, 0.4]), np.array([0.0, 20.0, 10.0]))
    np.testing.assert_allclose(corner[1] - corner[0], 2 * (corner[2] - corner[0]))
    np.testing.assert_allclose(corner[1], [1.8, -1])


# bends in space


SECTIONS = st.lists(
    st.tuples(st.floats(0.05, 1.0), st.floats(0.05, 2), st.floats(-3, 3)), min_size=1, max_size=6
)


@given(SECTIONS)
def test_turning_the_planes_of_bending_changes_no_length_and_no_bend(sections):
    length, radius, planes = np.array(sections).T
    s = np.linspace(0, length.sum(), 8001)
    line = compute_centreline(length, radius, s, 0.0, planes)
    chords = np.diff(line.points, axis=0)
    assert np.linalg.norm(chords, axis=1).sum() == pytest.approx(length.sum(), rel=1e-5)
    unit = chords / np.linalg.norm(chords, axis=1, keepdims=True)
    turned = np.arccos(np.clip((unit[1:] * unit[:-1]).sum(axis=1), -1, 1)).sum()
    assert turned == pytest.approx((length / radius).sum(), rel=5e-3)
    assert line.along @ line.aside == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(unit[-1], line.along, atol=s[1] / radius[-1] + 1e-6)


def test_a_quarter_turn_of_the_plane_takes_the_second_bend_upwards():
    quarter = math.pi / 2
    line = compute_centreline(
        np.array([quarter, quarter]), np.ones(2), np.array([2 * quarter]), 0.0, (0, quarter)
    )
    # the first bend turns left, in the plane; the second leaves it
    np.testing.assert_allclose(line.points[0], [1, 2, 1], atol=1e-9)
    np.testing.assert_allclose(line.along, [0, 0, 1], atol=1e-9)


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_the_quaternion_turns_z_into_the_direction(direction):
    x, y, z, w = compute_rotations_from_z(np.array([direction]))[0]
    turned = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    np.testing.assert_allclose(turned, direction / np.linalg.norm(direction), atol=1e-4)


# the stage


def arm(joints):
    shape = ((0.4, 0.5, 0.4), (math.inf, 0.15, 0.4))
    return {t: Shape(t // 2, *shape) for t in range(2 * joints)}


@pytest.mark.parametrize("joints", [1, 4, 8])
def test_the_sheaths_of_a_joint_stand_side_by_side(joints):
    config = ViewConfig()
    placed = build_stage(arm(joints), config)
    for t in range(1, 2 * joints, 2):
        apart = np.linalg.norm(placed.lines[t] - placed.lines[t - 1], axis=1)
        assert np.ptp(apart) < 1e-9
        assert apart[0] == pytest.approx(config.tendon_spacing * placed.size)
        assert apart[0] > 2 * config.tube_radius * placed.size  # tubes do not touch


@pytest.mark.parametrize("joints", [2, 3, 4, 8])
def test_no_joint_hides_another(joints):
    placed = build_stage(arm(joints), ViewConfig())
    boxes = []
    for joint in range(joints):
        lever, hand = placed.joints[joint], placed.hands[joint]
        turned = np.linspace(-1, 1, 9)
        points = np.concatenate(
            [placed.lines[2 * joint], placed.lines[2 * joint + 1],
             lever.tip(turned * lever.radius), hand.tip(turned * hand.radius)]
        )  # fmt: skip
        away = (points - placed.centre) / placed.span - EYE
        depth = away @ -np.array(EYE) / np.linalg.norm(EYE)
        seen = np.stack([away[:, 0], away @ UP], axis=1) / depth[:, None]
        boxes.append((seen.min(axis=0), seen.max(axis=0)))
    for (low_a, high_a), (low_b, high_b) in combinations(boxes, 2):
        assert ((high_a < low_b) | (high_b < low_a)).any()


@pytest.mark.parametrize("joints", [1, 4, 8])
def test_a_joint_keeps_its_shape_wherever_it_stands(joints):
    placed, alone = build_stage(arm(joints), ViewConfig()), build_stage(arm(1), ViewConfig())
    for joint in range(joints):
        for mine, single in (
            (placed.lines[2 * joint + 1] - placed.lines[2 * joint][0],
             alone.lines[1] - alone.lines[0][0]),
            (placed.joints[joint].pivot - placed.lines[2 * joint][0],
             alone.joints[0].pivot - alone.lines[0][0]),
            (placed.hands[joint].pivot - placed.lines[2 * joint][0],
             alone.hands[0].pivot - alone.lines[0][0]),
        ):  # fmt: skip
            np.testing.assert_allclose(mine, single, atol=1e-9)


@pytest.mark.parametrize("joints", [1, 4, 8])
def test_everything_fits_into_the_view(joints):
    placed = build_stage(arm(joints), ViewConfig())
    ends = [lever.pivot[None] for lever in (*placed.joints.values(), *placed.hands.values())]
    points = np.concatenate([*placed.lines.values(), *ends, placed.legend[None]])
    away = (points - placed.centre) / placed.span - EYE
    up = placed.legend_up / np.linalg.norm(placed.legend_up)
    depth = away @ -np.array(EYE) / np.linalg.norm(EYE)
    # Rerun's eye sees 55 degrees upwards; in `experiment` the view is 1.56 times as wide as high
    assert (depth > 0).all()
    assert np.abs(away @ up / depth).max() < math.tan(math.radians(27.5))
    assert np.abs(away[:, 0] / depth).max() < 1.56 * math.tan(math.radians(27.5))
    sheaths = np.concatenate(list(placed.lines.values()))
    filled = (sheaths - placed.centre) / placed.span - EYE
    assert np.ptp(filled[:, 0] / (filled @ -np.array(EYE) / np.linalg.norm(EYE))) > 0.7


def test_a_lever_turns_by_travel_over_radius():
    lever = build_stage(arm(1), ViewConfig(joint_radius_m=0.01)).joints[0]
    at = lever.tip(np.array([0.0, 0.01 * math.pi / 2]))
    np.testing.assert_allclose(at[0] - lever.pivot, lever.length * lever.along)
    np.testing.assert_allclose(at[1] - lever.pivot, lever.length * lever.aside, atol=1e-9)
    step = lever.tip(np.array([0.003 + 1e-7])) - lever.tip(np.array([0.003]))
    np.testing.assert_allclose(
        step[0] / np.linalg.norm(step), lever.onward(np.array([0.003]))[0], atol=1e-4
    )


# what slides, and what is certain


def test_the_part_before_the_front_slides():
    slides = find_sliding_segments(np.array([0.0, 0.4, 0.8, math.nan]), np.full(4, 0.8))
    assert slides.sum(axis=1).tolist() == [0, 32, 64, 0]
    assert (np.diff(slides.astype(int), axis=1) <= 0).all()


def test_a_place_on_the_line_lies_between_its_points():
    line = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]])
    np.testing.assert_allclose(
        interpolate_line(line, np.array([0.25, 0.75])), [[0.5, 0, 0], [1, 0.5, 0]]
    )


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


def test_a_known_tip_pins_the_band_there():
    k = compute_friction_profile(np.array([1.0]), np.array([0.5]), 0.8, PROFILE_POINTS)
    T = 10 * np.exp(-k)
    low, high = compute_tension_band(k, T[:1], T[-1:], T[-1:])
    np.testing.assert_allclose(low[0], T)  # sliding all along: no freedom anywhere
    np.testing.assert_allclose(high[0, [0, -1]], T[[0, -1]])


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"bend_planes": (0.0, 7.0)}, "bend_planes.1"),
        ({"environment_m": (-math.inf,)}, "environment_m.0"),
        ({"tendon_spacing": 0.0}, "tendon_spacing"),
        ({"hand_scale_N": 0.0}, "hand_scale_N"),
    ],
)
def test_a_scene_out_of_range_is_refused_by_name(change, field):
    with pytest.raises(ValueError, match=f"^{field}: "):
        ViewConfig(**change)
