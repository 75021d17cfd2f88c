"""The panel: large letters, the state of a session, the force with its limit, the link."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.messages.messages import MAX_JOINTS, Command, Hand, LoopReport, SlaveState, pad_values
from teleop.messages.topics import COMMAND, HAND, REPORT, SHEATH, STATE, Role
from teleop.session.state_machine import Reason, State
from teleop.view import panel
from teleop.view.colours import STATES
from teleop.view.columns import decode
from teleop.view.config import ViewConfig
from teleop.view.feed import Pacing
from teleop.view.panel import (
    Banner,
    LinkCounts,
    LinkQuality,
    build_banner,
    compute_link_quality,
    format_force,
    format_link_parts,
)
from teleop.view.panel_layout import (
    _GLYPHS,
    BANNER,
    LINK_HEIGHT,
    LINK_LEFT,
    LINK_TOP,
    PANEL_HEIGHT,
    PANEL_WIDTH,
    STROKE,
    build_text_strips,
    compute_force_rows,
    compute_text_width,
    fill_box,
    fit_height,
)
from teleop.view.profile_plot import compute_axis_end, compute_ticks, compute_ticks_to_end
from teleop.view.scene import Scene
from teleop.view.sinks import Sink
from tests.teleop.view_session import T0, Session, read

SURGEON = ViewConfig(layout="surgeon", tension_scale_N=10.0)

# letters


def test_text_fills_its_width_and_height_and_no_more():
    strips = build_text_strips("ENGAGED 12", 1.0, 2.0, 3.0)
    points = np.concatenate(strips)
    assert points.min(axis=0) == pytest.approx([1.0, 2.0])
    assert points.max(axis=0) == pytest.approx([1.0 + compute_text_width("ENGAGED 12", 3.0), 5.0])


def test_a_decimal_point_stands_midway_between_its_digits_and_near_to_them():
    eight = len(build_text_strips("8", 0.0, 0.0, 6.0))
    strips = build_text_strips("8.8", 0.0, 0.0, 6.0)
    before, point, after = (
        np.concatenate(part)[:, 0]
        for part in (strips[:eight], strips[eight:-eight], strips[-eight:])
    )
    gaps = point.min() - before.max(), after.min() - point.max()
    assert gaps[0] == pytest.approx(gaps[1])
    assert gaps[0] < 2.5  # of a digit that is 4 wide


def test_every_letter_of_a_reason_and_a_state_has_a_glyph_and_all_glyphs_differ():
    words = " ".join([reason.text for reason in Reason] + [state.name for state in State])
    assert set(words.upper()) - set(_GLYPHS) - {" "} == set()
    drawn = [strokes for letter, strokes in _GLYPHS.items() if letter != "O"]  # O is as 0
    assert len(set(drawn)) == len(drawn)


def test_every_reason_fits_on_the_banner():
    for reason in Reason:
        text = build_banner(dict.fromkeys((Role.MASTER, Role.SLAVE), (State.FAULT, reason))).reason
        height = fit_height(text, PANEL_WIDTH - 0.8, 0.45)
        assert compute_text_width(text, height) <= PANEL_WIDTH - 0.8 + 1e-9
        assert height > 0.2


# the state of a session


@given(st.sampled_from(State), st.sampled_from(State))
def test_a_session_is_engaged_only_if_both_sides_are(master, slave):
    shown = build_banner({Role.MASTER: (master, 0), Role.SLAVE: (slave, 0)}).state
    assert (shown == "engaged") == (master == slave == State.ENGAGED)
    if State.STOPPED in (master, slave):
        assert shown == "stopped"
    elif State.FAULT in (master, slave):
        assert shown == "fault"


def test_of_two_faults_the_first_hand_reason_is_quoted():
    sides = {
        Role.MASTER: (State.FAULT, Reason.PEER_FAULT),
        Role.SLAVE: (State.FAULT, Reason.TENDON_BROKEN),
    }
    assert build_banner(sides) == Banner("fault", Reason.TENDON_BROKEN.text)
    assert build_banner({Role.SLAVE: (State.READY, 0)}).reason == "waiting for the master"


@pytest.mark.parametrize(("role", "peer"), [(Role.MASTER, "slave"), (Role.SLAVE, "master")])
def test_the_banner_names_the_side_that_sends_nothing(role, peer):
    other = {Role.MASTER: Role.SLAVE, Role.SLAVE: Role.MASTER}[role]
    sides = {role: (State.FAULT, Reason.PEER_SILENT), other: (State.ENGAGED, Reason.NONE)}
    assert build_banner(sides).reason == f"no messages from the {peer}"


def test_a_link_over_which_nothing_comes_has_no_figures():
    counts = {Role.SLAVE: LinkCounts(1000, 0)}
    assert compute_link_quality(counts, counts, 0.5).word == "good"  # the report of the other side
    quality = compute_link_quality(counts, counts, 0.5, deaf=True)
    assert format_link_parts(quality, 0.1, []) == ("no link", "", "", "")


def test_the_link_is_as_good_as_its_worse_way():
    before = {Role.MASTER: LinkCounts(1000, 0), Role.SLAVE: LinkCounts(1000, 5)}
    now = {Role.MASTER: LinkCounts(1500, 0), Role.SLAVE: LinkCounts(1475, 30)}
    quality = compute_link_quality(before, now, 0.5)
    assert quality.word == "poor"
    assert quality.loss == pytest.approx(0.05)
    assert compute_link_quality(now, now, None).word == "good"


# the panel


@pytest.mark.parametrize("joints", range(1, MAX_JOINTS + 1))
def test_the_rows_of_forces_neither_meet_each_other_nor_the_banner(joints):
    """Nor do their strokes, with a gap of a stroke's width between them."""
    words_top, height, rows = compute_force_rows(joints)
    assert words_top - STROKE * height > BANNER[3] + 2 * STROKE * height
    edges = [words_top + (1 + STROKE) * height]
    for row in rows:
        number_ink = STROKE * row.number_height
        _, top, _, bottom = row.bar(1.0, two_way=False)
        assert min(top, row.number_top - number_ink) > edges[-1] + 2 * number_ink
        edges.append(max(bottom, row.number_top + row.number_height + number_ink))
    assert edges[-1] < LINK_TOP - 2 * STROKE * LINK_HEIGHT
    assert LINK_TOP + LINK_HEIGHT < PANEL_HEIGHT


def test_the_name_of_a_single_force_stands_well_above_its_number():
    top, height, (row,) = compute_force_rows(1)
    assert row.number_top - top - height > 1.5 * height


@pytest.mark.parametrize("joints", range(2, MAX_JOINTS + 1))
def test_the_name_of_one_of_several_forces_stands_left_of_its_number_and_within_its_height(joints):
    for row in compute_force_rows(joints)[2]:
        right = 0.4 + compute_text_width("joint 8", row.name_height)
        assert right < row.number_right - compute_text_width("-9999", row.number_height) - 0.1
        assert row.name_top > row.number_top
        assert row.name_top + row.name_height < row.number_top + row.number_height


@pytest.mark.parametrize("allowed", [[], ["", "scaled to 50 %"]])
@pytest.mark.parametrize("delay_ms", [0.04, 123.0, 1e6])
def test_each_part_of_the_link_line_ends_before_the_next(allowed, delay_ms):
    parts = format_link_parts(LinkQuality("good", 1.0, delay_ms), delay_ms, allowed)
    for text, left, right in zip(parts, LINK_LEFT, [*LINK_LEFT[1:], PANEL_WIDTH], strict=True):
        assert left + compute_text_width(text, LINK_HEIGHT) < right - 0.1


def test_what_is_not_known_of_the_link_is_left_out():
    assert format_link_parts(LinkQuality("good", 0.0, None), None, []) == (
        "link good", "0.0 % lost", "", ""
    )  # fmt: skip


@pytest.mark.parametrize("force", [0.0, -12.34, 99.96, -99.96, -9999.0, math.nan])
@pytest.mark.parametrize("joints", [1, 4, 8])
def test_every_force_fits_between_the_edge_and_its_unit(force, joints):
    for row in compute_force_rows(joints)[2]:
        assert row.number_right - compute_text_width(format_force(force), row.number_height) > 0.2
        unit_right = row.number_right + (row.unit_gap + 0.5 * 4 / 6 + STROKE) * row.number_height
        assert unit_right < row.bar(0.0, two_way=False)[0]


@given(st.floats(-3, 3), st.booleans())
def test_a_bar_is_as_long_as_its_share_and_ends_at_the_limit(share, two_way):
    _, _, (row,) = compute_force_rows(1)
    left, _, right, _ = row.bar(share, two_way)
    full = row.bar(1.0, two_way)
    expected = min(abs(share), 1.0) if share > 0 or two_way else 0.0
    assert right - left == pytest.approx(expected * (full[2] - full[0]))


def test_a_filled_box_is_covered_and_not_left():
    lines, radius = fill_box((1.0, 2.0, 5.0, 3.0))
    points = np.concatenate(lines)
    assert points[:, 0].min() - radius == pytest.approx(1.0, abs=0.01)
    assert points[:, 0].max() + radius == pytest.approx(5.0, abs=0.01)
    assert np.diff([line[0, 1] for line in lines]).max() < 2 * radius


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A session that engages at 0.5 s and falls silent after a second."""
    session = Session(0)
    for k in range(100):
        stamp = T0 + k * 10_000_000
        state = State.READY if k < 50 else State.ENGAGED
        session.add(HAND, Hand(state=state, joints=1), stamp)
        force = pad_values((6.0,), MAX_JOINTS)
        session.add(STATE, SlaveState(state=state, joints=1, force=force), stamp)
        session.add(COMMAND, Command(force_max=12.0 if k < 99 else 0.0), stamp)  # off
    session.add(REPORT, LoopReport(role=Role.MASTER, received=100), stamp)
    path = tmp_path_factory.mktemp("panel") / "panel.rrd"
    with Sink("rrd", SURGEON, "test", path, live=False) as sink:
        scene = Scene(SURGEON, sink.stream, sink.lay_out)
        scene.send(decode(session.messages))
        scene.silence(2_000_000_000)
    return read(path)


def test_the_banner_follows_the_state_and_says_when_nothing_comes(drawn):
    colours = drawn["/panel/banner/area"]["LineStrips2D:colors"]
    states = [STATES[name] for name in ("ready", "engaged", "no data")]
    assert [values[0] for _, values in sorted(colours.items())] == states
    assert sorted(colours) == [T0, T0 + 500_000_000, T0 + 990_000_000 + 2_000_000_000]


def test_before_the_first_message_the_banner_is_of_now(tmp_path, monkeypatch):
    path = tmp_path / "panel.rrd"
    monkeypatch.setattr(panel, "now_ns", lambda: T0)
    with Sink("rrd", SURGEON, "test", path, live=False) as sink:
        Scene(SURGEON, sink.stream, sink.lay_out).silence(2_000_000_000)
    assert list(read(path)["/panel/banner/area"]["LineStrips2D:colors"]) == [T0]


def test_the_newest_banner_is_that_of_the_last_message_whose_clock_is_behind(tmp_path):
    master, slave = Session(0), Session(0)
    master.add(HAND, Hand(state=State.ENGAGED, joints=1), T0 + 400_000_000)
    slave.add(STATE, SlaveState(state=State.ENGAGED, joints=1), T0)
    path = tmp_path / "panel.rrd"
    with Sink("rrd", SURGEON, "test", path, live=False) as sink:
        scene = Scene(SURGEON, sink.stream, sink.lay_out)
        for session in (master, slave):
            scene.send(decode(session.messages))
    colours = read(path)["/panel/banner/area"]["LineStrips2D:colors"]
    assert colours[max(colours)][0] == STATES["engaged"]


def test_the_whole_banner_is_repeated_while_nothing_changes(tmp_path):
    """For pages opened later: the server drops the oldest data."""
    path = tmp_path / "panel.rrd"
    with Sink("rrd", SURGEON, "test", path, live=False) as sink:
        scene = Scene(SURGEON, sink.stream, sink.lay_out)
        for k in range(40):
            session, stamp = Session(0), T0 + k * 250_000_000
            session.add(HAND, Hand(state=State.ENGAGED, joints=1), stamp)
            session.add(STATE, SlaveState(state=State.ENGAGED, joints=1), stamp)
            scene.send(decode(session.messages))
    entities = read(path)
    for part in ("area", "state"):
        drawn = entities[f"/panel/banner/{part}"]["LineStrips2D:strips"]
        stamps = sorted([*drawn, T0 + 9_750_000_000])
        assert np.diff(stamps).max() <= 2_250_000_000
        assert all(drawn.values())


def test_the_bar_shows_the_force_as_a_share_of_its_limit(drawn):
    strips = list(drawn["/panel/joint_0/bar"]["LineStrips2D:strips"].values())[-2]
    left, _, right, _ = compute_force_rows(1)[2][0].bar(0.5, two_way=False)
    points = np.array(strips).reshape(-1, 2)
    assert points[:, 0].max() == pytest.approx(right, abs=0.1)
    assert points[:, 0].min() == pytest.approx(left, abs=0.1)


def empty(drawn, part):
    """Return whether the newest drawing of a part has no line."""
    newest = max(drawn[part]["LineStrips2D:strips"].items())
    return len(newest[1]) == 0


def test_neither_force_nor_link_outlives_a_session(drawn):
    assert empty(drawn, "/panel/joint_0/bar")
    assert empty(drawn, "/panel/link")
    dashes = max(drawn["/panel/joint_0/number"]["LineStrips2D:strips"].items())[1]
    assert len(dashes) == 3
    assert all(strip[0][1] == strip[-1][1] for strip in dashes)


def test_a_force_does_not_outlive_its_slave_and_the_link_is_none_without_messages(tmp_path):
    path, session = tmp_path / "panel.rrd", Session(0)
    with Sink("rrd", SURGEON, "test", path, live=False) as sink:
        scene = Scene(SURGEON, sink.stream, sink.lay_out)
        for k in range(30):
            session, stamp = Session(0), T0 + k * 100_000_000
            session.add(HAND, Hand(state=State.ENGAGED, joints=1), stamp)
            if k < 10:
                state = SlaveState(
                    state=State.ENGAGED, joints=1, force=pad_values((6.0,), MAX_JOINTS)
                )
                session.add(STATE, state, stamp)
            if k % 5 == 0:
                heard = LoopReport(role=Role.MASTER, received=100 * min(k, 10), lost=0)
                session.add(REPORT, heard, stamp)
            scene.send(decode(session.messages))
    entities = read(path)
    assert empty(entities, "/panel/joint_0/bar")
    bars = entities["/panel/joint_0/bar"]["LineStrips2D:strips"]
    last = T0 + 900_000_000
    assert 1_000_000_000 < max(bars) - last <= 1_200_000_000
    inks = entities["/panel/link"]["LineStrips2D:colors"]
    assert inks[max(inks)][0] != inks[min(inks)][0]


@pytest.mark.parametrize(("state", "shown"), [(State.READY, "off"), (State.FAULT, "fault")])
def test_a_side_that_sends_no_more_is_waited_for_unless_the_other_has_a_fault(
    tmp_path, state, shown
):
    path = tmp_path / "panel.rrd"
    with Sink("rrd", SURGEON, "test", path, live=False) as sink:
        scene = Scene(SURGEON, sink.stream, sink.lay_out)
        for k in range(30):
            session, stamp = Session(0), T0 + k * 100_000_000
            session.add(STATE, SlaveState(state=state, joints=1), stamp)
            if k < 10:
                session.add(HAND, Hand(state=State.READY, joints=1), stamp)
            scene.send(decode(session.messages))
    colours = read(path)["/panel/banner/area"]["LineStrips2D:colors"]
    assert colours[max(colours)][0] == STATES[shown]


def test_a_number_changes_four_times_a_second_however_short_the_blocks_are(tmp_path):
    session = Session(0)
    for k in range(200):
        force = pad_values((0.1 * k,), MAX_JOINTS)
        session.add(STATE, SlaveState(joints=1, force=force), T0 + k * 10_000_000)
    path = tmp_path / "panel.rrd"
    with Sink("rrd", SURGEON, "test", path, live=False) as sink:
        scene = Scene(SURGEON, sink.stream, sink.lay_out)
        for k in range(0, 200, 7):
            scene.send(decode(session.messages[k : k + 7]))
    entities = read(path)
    assert len(entities["/panel/joint_0/number"]["LineStrips2D:strips"]) in (8, 9)
    assert len(entities["/panel/joint_0/bar"]["LineStrips2D:strips"]) in (20, 21)


def test_a_force_both_ways_has_a_mark_at_zero_also_where_the_sheaths_come_later(tmp_path):
    session = Session(0.05)
    path = tmp_path / "panel.rrd"
    with Sink("rrd", SURGEON, "test", path, live=False) as sink:
        scene = Scene(SURGEON, sink.stream, sink.lay_out)
        for topics in ((STATE, COMMAND), (SHEATH,), (STATE,)):
            scene.send(decode([message for message in session.messages if message[0] in topics]))
    (frame,) = read(path)["/panel/joint_0/frame"]["LineStrips2D:strips"].values()
    assert len(frame) == len(compute_force_rows(1)[2][0].frame(two_way=True))


@pytest.mark.parametrize(
    ("layout", "shown"),
    [("surgeon", {"panel"}), ("presentation", {"panel", "scene"})],
)
def test_a_page_is_sent_only_what_its_layout_shows_and_a_file_everything(tmp_path, layout, shown):
    config = replace(SURGEON, layout=layout)
    sent = []
    for whole in (False, True):
        path = tmp_path / f"{whole}.rrd"
        with Sink("rrd", config, "test", path, live=False) as sink:
            scene = Scene(config, sink.stream, sink.lay_out, everything=whole)
            scene.send(decode(Session(1.0).messages))
        sent.append({entity.split("/")[1] for entity in read(path)} - {"__properties"})
    page, file = sent
    assert page == shown
    assert {"panel", "scene", "profile", "loop", "tension", "force", "state", "log"} <= file


# axes


@given(st.floats(0.01, 1000))
def test_an_axis_ends_on_a_tick_not_far_beyond_its_data(top):
    end = compute_axis_end(top)
    assert top * (1 - 1e-9) <= end < 1.7 * top
    assert compute_ticks(end)[-1] == pytest.approx(end)
    assert compute_ticks_to_end(top)[0] == 0.0
    assert compute_ticks_to_end(top)[-1] == top


# pacing


def test_a_view_that_would_take_too_much_draws_less_often_and_recovers():
    pacing, cost = Pacing(0.25), 0.9  # [s] of processor per second, without stretching
    used, shares = 0.0, []
    for second in range(1, 30):
        share = cost / pacing.stretch
        used += share
        shares.append(share)
        pacing.update(used, float(second))
    assert max(shares[10:]) <= 0.27
    for second in range(30, 60):
        pacing.update(used, float(second))
    assert pacing.stretch == 1.0


@pytest.mark.parametrize("keeps_up", [0.5, 2.0])
def test_a_page_that_does_not_keep_up_is_sent_less_until_it_does(keeps_up):
    """It takes in so many seconds a second of what comes without stretching, after a late start."""
    pacing, behind_s, worst_s = Pacing(1.0), 20.0, 0.0
    for second in range(120):
        behind_s = max(0.0, behind_s + 1.0 - keeps_up * pacing.stretch)
        worst_s = max(worst_s, behind_s)
        pacing.update(0.0, float(second), behind_s)
    assert worst_s < 25
    assert behind_s < 3
    assert keeps_up * pacing.stretch > 0.7
