"""What a Rerun file holds after a session, read back with Rerun's own reader."""

import dataclasses
import math

import numpy as np
import pytest

from estimator.law.sheath import Section
from estimator.law.sheath import Sheath as SheathModel
from estimator.online import online
from teleop.messages.messages import (
    MAX_JOINTS,
    MAX_TENDONS,
    PHASE_NAMES,
    PROFILE_POINTS,
    Event,
    Hand,
    Sheath,
    SlaveState,
    TendonState,
    TensionProfile,
    encode_text,
    pad_values,
)
from teleop.messages.topics import (
    COMMAND,
    EVENT,
    HAND,
    LEDGER,
    PROFILE,
    REPORT,
    SHEATH,
    STATE,
    STOP,
    TENDONS,
)
from teleop.session.state_machine import State
from teleop.view.colours import PHASES, to_rgba
from teleop.view.columns import decode
from teleop.view.config import LAYOUTS, ViewConfig
from teleop.view.curves import CURVES
from teleop.view.layouts import build_blueprint
from teleop.view.scene import Scene
from teleop.view.scene_geometry import PIECES, SEGMENTS, Shape, build_stage
from teleop.view.sinks import Sink
from tests.teleop.view_session import CONFIG, T0, Session, front_of, read, reader, save, sheath


@pytest.fixture(scope="module")
def session():
    return Session()


@pytest.fixture(scope="module")
def saved(session, tmp_path_factory):
    """The session fed in blocks of 40 ms, and read back."""
    return save(session.messages, tmp_path_factory.mktemp("view") / "session.rrd")


@pytest.fixture(scope="module")
def placed():
    shape = Shape(0, (0.3, 0.5), (math.inf, 0.2))
    return build_stage({0: shape, 1: shape}, CONFIG)


def at(series, stamp):
    """Return the newest value at a moment, as the viewer would show it."""
    return series[max(s for s in series if s <= stamp)]


def test_a_stretched_scene_draws_fewer_rows_in_proportion_and_always_the_newest(session, tmp_path):
    saved, fewer = (
        save(session.messages, tmp_path / "session.rrd", len(session.messages), stretch=stretch)
        for stretch in (1.0, 5.0)
    )
    for path, component in (
        ("/profile/tendon_0/tension", "tension"),
        ("/scene/tendon_0/tube", "Capsules3D:colors"),
        ("/scene/joint_0/link", "LineStrips3D:strips"),
        ("/loop/tendon_0/curve", "LineStrips2D:strips"),
        ("/tension/tendon_0/in", "Scalars:scalars"),
    ):
        whole = [stamp for stamp in saved[path][component] if stamp is not None]
        few = [stamp for stamp in fewer[path][component] if stamp is not None]
        assert len(few) == pytest.approx(len(whole) / 5, abs=2), path
        assert max(few) == max(whole)


# the tension along the sheath


def test_the_profile_arrives_as_it_was_sent(session, saved):
    for tendon in (0, 1):
        sent = {m.stamp_ns: m.tension for m in session.of(PROFILE) if m.tendon == tendon}
        shown = saved[f"/profile/tendon_{tendon}/tension"]["tension"]
        assert len(shown) >= 20
        for stamp, tension in shown.items():
            np.testing.assert_allclose(tension, sent[stamp], atol=1e-6)


def test_T_of_x_is_the_estimators_profile_at_chosen_instants(tmp_path):  # noqa: N802
    """The estimator on a tendon pulled and let go, from its own state to the file."""
    model = SheathModel((Section(0.3), Section(0.8, 0.25)), 0.15, 9000.0)
    prepared = online.prepare(online.TendonModel(model))
    state = online.build_initial_state(prepared)
    told = Session(0)
    length, radius = (
        pad_values([getattr(s, name) for s in model.sections], 16) for name in ("length", "radius")
    )
    told.add(
        SHEATH,
        Sheath(
            sections=2, section_length=length, section_radius=radius, effective_friction=model.K
        ),
        T0,
    )
    x = np.linspace(0.0, model.length, PROFILE_POINTS)
    expected = {}
    for k in range(3000):
        time_s = k * 1e-3
        T = 6 - 4 * math.cos(2 * math.pi * time_s)
        estimate, state = online.step(prepared, state, T, T * 5e-5, 1e-3)
        if k % 20 == 0:
            stamp = T0 + k * 1_000_000
            expected[stamp] = (online.compute_profile(prepared, state, x), estimate.front)
            profile = TensionProfile(
                length=model.length,
                front=estimate.front,
                tension=tuple(expected[stamp][0].tolist()),
            )
            told.add(PROFILE, profile, stamp)
    file = save(told.messages, tmp_path / "run.rrd", block=1)
    line = build_stage({0: Shape(0, length[:2], radius[:2])}, CONFIG).lines[0]
    fronts = []
    for moment in np.arange(0.5, 3.0, 0.173):
        stamp = T0 + round(moment * 1e9)
        T, front = at(expected, stamp)
        shown = at(file["/profile/tendon_0/tension"]["tension"], stamp)
        np.testing.assert_allclose(shown, T, atol=1e-6)
        (ball,) = at(file["/scene/tendon_0/tube"]["Points3D:positions"], stamp)
        fronts.append(front)
        whole = np.linspace(0, model.length, SEGMENTS * PIECES + 1)
        there = [np.interp(front, whole, line[:, axis]) for axis in range(3)]
        np.testing.assert_allclose(ball, there, atol=1e-6)
    assert np.ptp(fronts) > 0.3, "the front did not travel"


def test_the_plotted_curve_is_the_profile_in_two_pieces_that_meet_at_the_front(session, saved):
    sent = {m.stamp_ns: m for m in session.of(PROFILE) if m.tendon == 1}
    fronts = saved["/profile/tendon_1/curve"]["Points2D:positions"]
    for stamp, pieces in saved["/profile/tendon_1/curve"]["LineStrips2D:strips"].items():
        message, (slides, sticks) = sent[stamp], (np.array(piece) for piece in pieces)
        x = np.linspace(0, 0.8, PROFILE_POINTS)
        for piece in (slides, sticks):
            drawn = piece * [0.8 / 1.8, -CONFIG.tension_scale_N]
            curve = np.interp(drawn[:, 0], x, message.tension)
            np.testing.assert_allclose(drawn[:, 1], curve, rtol=1e-5)
        np.testing.assert_allclose(slides[-1], fronts[stamp][0], atol=1e-6)
        np.testing.assert_allclose(sticks[0], fronts[stamp][0], atol=1e-6)
        assert slides[-1][0] == pytest.approx(1.8 * message.front / 0.8, rel=1e-5)
        assert slides[0][0] == pytest.approx(0, abs=1e-6)
        assert sticks[-1][0] == pytest.approx(1.8, rel=1e-5)


def test_the_band_holds_the_interval_of_the_tip(session, saved):
    told = {m.stamp_ns: m for m in session.of(TENDONS)}
    band = saved["/profile/tendon_0/band"]
    assert len(band["low"]) >= 20
    for stamp in band["low"]:
        low, high = np.array(band["low"][stamp]), np.array(band["high"][stamp])
        assert low[-1] >= told[stamp].distal_tension_low[0] - 1e-6
        assert high[-1] <= told[stamp].distal_tension_high[0] + 1e-6
        T_in = at(saved["/profile/tendon_0/tension"]["tension"], stamp)[0]
        assert low[0] == pytest.approx(max(T_in, low[0]))


# the tubes


def test_the_tube_has_the_colour_of_its_tension(session, saved):
    sent = {m.stamp_ns: np.array(m.tension) for m in session.of(PROFILE) if m.tendon == 0}
    shown = saved["/scene/tendon_0/tube"]["Capsules3D:colors"]
    assert len(shown) >= 20
    for stamp, colours in shown.items():
        middle = [(a + b) / 2 for a, b in zip(sent[stamp], sent[stamp][1:], strict=False)]
        expected = [int(to_rgba(np.array([t]), CONFIG.tension_scale_N)[0]) for t in middle]
        assert colours == expected


def test_the_tube_is_thick_as_far_as_the_front(session, saved):
    sent = {m.stamp_ns: m for m in session.of(PROFILE) if m.tendon == 0}
    for stamp, radii in saved["/scene/tendon_0/tube"]["Capsules3D:radii"].items():
        thick = np.array(radii) > 0.75 * max(radii)
        if thick.all() or min(radii) == max(radii):
            continue
        assert thick.sum() == pytest.approx(64 * sent[stamp].front / 0.8, abs=0.51)
        assert (np.diff(thick.astype(int)) <= 0).all()


def test_the_tube_is_the_sheath(saved, placed):
    for tendon in (0, 1):
        tube = saved[f"/scene/tendon_{tendon}/tube"]
        begins = np.array(tube["Capsules3D:translations"][None])
        np.testing.assert_allclose(begins, placed.lines[tendon][:-1:PIECES], atol=1e-6)
        assert len(begins) == SEGMENTS
        np.testing.assert_allclose(tube["Capsules3D:lengths"][None], 0.8 / 64, rtol=1e-3)


def test_the_front_is_marked_where_it_is(session, saved, placed):
    sent = {m.stamp_ns: m for m in session.of(PROFILE) if m.tendon == 1}
    marks = saved["/scene/tendon_1/tube"]["Points3D:positions"]
    assert len(marks) >= 20
    whole = np.linspace(0, 0.8, SEGMENTS * PIECES + 1)
    for stamp, (position,) in marks.items():
        there = [np.interp(sent[stamp].front, whole, placed.lines[1][:, k]) for k in range(3)]
        np.testing.assert_allclose(position, there, atol=1e-6)
    assert front_of(0, 1) == pytest.approx(0.4)


def test_a_front_that_is_not_known_is_not_drawn(tmp_path):
    session = Session(0.05)
    lost = TensionProfile(length=0.8, front=math.nan, tension=(math.nan,) * PROFILE_POINTS)
    session.add(PROFILE, lost, T0 + 60_000_000)
    file = save(session.messages, tmp_path / "lost.rrd")
    assert not file["/scene/tendon_0/tube"]["Points3D:positions"][T0 + 60_000_000]
    grey = file["/scene/tendon_0/tube"]["Capsules3D:colors"][T0 + 60_000_000]
    assert set(grey) == {0x808080FF}


def test_the_colour_scale_stands_in_the_scene_with_its_newtons(saved):
    words = saved["/scene/legend/values"]
    texts, places = words["Points3D:labels"][None], np.array(words["Points3D:positions"][None])
    bar = saved["/scene/legend/scale"]
    vertices = np.array(bar["Mesh3D:vertex_positions"][None])
    colours = bar["Mesh3D:vertex_colors"][None]
    foot, top = vertices[0], vertices[len(vertices) // 2 - 1]
    for text, place in zip(texts, places, strict=True):
        tension = float(text.removesuffix(" N"))
        share = (place - foot) @ (top - foot) / ((top - foot) @ (top - foot))
        assert share * CONFIG.tension_scale_N == pytest.approx(tension, abs=1e-3)
    for share in (0.0, 0.25, 0.5, 1.0):
        colour = colours[round(share * 64)]
        assert colour == int(to_rgba(np.array([share * 10.0]), CONFIG.tension_scale_N)[0])


# joint, tip and hand


def test_the_arrow_at_the_tip_is_the_force_against_pulling(session, saved, placed):
    sent = {m.stamp_ns: m for m in session.of(STATE)}
    arrows = saved["/scene/joint_0/force"]
    lever = placed.joints[0]
    lengths, forces = [], []
    for stamp, (vector,) in arrows["Arrows3D:vectors"].items():
        travel, force = sent[stamp].position[0], sent[stamp].force[0]
        (origin,) = arrows["Arrows3D:origins"][stamp]
        np.testing.assert_allclose(origin, lever.tip(np.array([travel]))[0], atol=1e-5)
        onward = lever.onward(np.array([travel]))[0]
        assert np.dot(vector, onward) == pytest.approx(-np.linalg.norm(vector), abs=1e-5)
        lengths.append(np.linalg.norm(vector))
        forces.append(force)
    np.testing.assert_allclose(lengths, np.array(forces) * max(lengths) / max(forces), atol=1e-5)


def test_the_interval_reaches_from_its_low_to_its_high_end(session, saved):
    sent = {m.stamp_ns: m for m in session.of(STATE)}
    arrows = saved["/scene/joint_0/force"]
    beyond = 0
    for stamp, (strip,) in saved["/scene/joint_0/force"]["LineStrips3D:strips"].items():
        message, drawn = sent[stamp], np.array(strip)
        (origin,), (vector,) = (
            np.array(arrows[f"Arrows3D:{part}"][stamp]) for part in ("origins", "vectors")
        )
        newton = vector / message.force[0]
        low, high = message.force_low[0], message.force_high[0]
        for force, place, bar in ((low, drawn[2], drawn[:2]), (high, drawn[3], drawn[4:])):
            within = force <= CONFIG.tension_scale_N
            beyond += not within
            shown = min(force, CONFIG.tension_scale_N)
            np.testing.assert_allclose(place, origin + shown * newton, atol=1e-5)
            assert (np.linalg.norm(bar[1] - bar[0]) > 0.01) == within, "a bar is an end"
    assert beyond, "no end lay beyond the scale"


def test_the_arrow_at_the_tip_says_its_newtons(session, saved):
    sent = {m.stamp_ns: m for m in session.of(STATE)}
    words = saved["/scene/joint_0/force"]["Points3D:labels"]
    assert len(words) >= 20
    for stamp, (text,) in words.items():
        assert float(text.removesuffix(" N")) == pytest.approx(sent[stamp].force[0], abs=0.051)


def test_with_several_joints_each_number_says_whose_it_is(tmp_path):
    several = Session(0)
    for tendon in (0, 1):
        several.add(SHEATH, dataclasses.replace(sheath(tendon), joint=tendon), T0)
    several.add(STATE, SlaveState(joints=2, force=pad_values((1.0, -7.8), MAX_JOINTS)), T0)
    several.add(HAND, Hand(joints=2, force=pad_values((0.5, -2.0), MAX_JOINTS)), T0)
    drawn = save(several.messages, tmp_path / "two.rrd")
    for path, word in (
        ("joint_0/force", "1: 1.0 N"),
        ("joint_1/force", "2: -7.8 N"),
        ("hand_1/handle", "2: -2.0 N"),
    ):
        assert drawn[f"/scene/{path}"]["Points3D:labels"] == {T0: [word]}


def test_the_environment_is_drawn_where_the_config_says(session, tmp_path):
    config = ViewConfig(tension_scale_N=10.0, environment_m=(0.005,), joint_radius_m=0.01)
    file = save(session.messages[:50], tmp_path / "x.rrd", config=config)
    rim = np.array(file["/scene/joint_0/environment"]["Mesh3D:vertex_positions"][None])[1]
    shape = Shape(0, (0.3, 0.5), (math.inf, 0.2))
    lever = build_stage({0: shape, 1: shape}, config).joints[0]
    np.testing.assert_allclose(rim, lever.tip(np.array([0.005]))[0], atol=1e-5)


def test_without_a_sensor_at_the_tip_no_truth_is_drawn(tmp_path):
    session = Session(0)
    session.add(
        SHEATH,
        Sheath(sections=1, section_length=pad_values((0.5,), 16), section_radius=(math.inf,) * 16),
        T0,
    )
    blind = TendonState(tendons=1, bench_distal_tension=(math.nan,) * MAX_TENDONS)
    session.add(TENDONS, blind, T0)
    session.add(STATE, SlaveState(joints=1, force=pad_values((1.0,), MAX_JOINTS)), T0)
    file = save(session.messages, tmp_path / "x.rrd")
    assert "Arrows3D:vectors" not in file["/scene/joint_0/truth"]
    assert "Arrows3D:vectors" in file["/scene/joint_0/force"]
    assert "/force/joint_0/true" not in file


# the loop


def test_the_loop_is_drawn_piece_by_piece_in_the_colour_of_its_phase(session, saved):
    sent = {m.stamp_ns: m for m in session.of(TENDONS)}
    loop = saved["/loop/tendon_0/curve"]
    scale = CONFIG.tension_scale_N
    end = None
    for stamp, (strip,) in sorted(loop["LineStrips2D:strips"].items()):
        message, (begin, now) = sent[stamp], np.array(strip)
        assert end is None or np.allclose(begin, end), "the loop has a gap"
        end = now
        seen = (now[0] * scale, -now[1] * scale)
        told = (message.proximal_tension[0], message.distal_tension[0])
        assert seen == pytest.approx(told, rel=1e-5)
        assert loop["LineStrips2D:colors"][stamp] == [PHASES[message.phase[0]]]
    assert len(set(map(tuple, loop["LineStrips2D:colors"].values()))) >= 3
    assert saved["/loop/names"]["Points2D:labels"][None] == list(PHASE_NAMES)


# curves over time


@pytest.mark.parametrize(
    ("entity", "topic", "value"),
    [
        ("/tension/tendon_0/in", TENDONS, lambda m: m.proximal_tension[0]),
        ("/tension/tendon_1/in", TENDONS, lambda m: m.proximal_tension[1]),
        ("/tension/tendon_1/out", TENDONS, lambda m: m.distal_tension[1]),
        ("/tension/tendon_0/out", TENDONS, lambda m: m.distal_tension[0]),
        ("/tension/tendon_0/out_true", TENDONS, lambda m: m.bench_distal_tension[0]),
        ("/elongation/tendon_0", TENDONS, lambda m: m.elongation[0] * 1e3),
        ("/force/joint_0/tip", STATE, lambda m: m.force[0]),
        ("/position/joint_0/tip", STATE, lambda m: m.position[0] * 1e3),
        ("/hand/joint_0/force", HAND, lambda m: m.force[0]),
        ("/position/joint_0/asked", COMMAND, lambda m: m.position[0] * 1e3),
        ("/energy/slave/joint_0/dissipated", LEDGER, lambda m: m.dissipated[0] * 1e3),
        ("/rate/slave", REPORT, lambda m: m.rate_hz),
        ("/latency/slave/late", REPORT, lambda m: m.lateness_max_ns / 1e6),
        ("/loss/slave/lost", REPORT, lambda m: m.lost),
    ],
)
def test_curves_hold_the_values_that_were_sent(session, saved, entity, topic, value):
    sent = {m.stamp_ns: value(m) for m in session.of(topic)}
    shown = saved[entity]["Scalars:scalars"]
    assert max(shown) == max(sent), "the newest is missing"
    rate = getattr(CONFIG.rate_hz, topic.name, 2)
    assert rate - 2 <= len(shown) <= rate + 27  # of one second, in 26 blocks
    for stamp, (number,) in shown.items():
        assert number == pytest.approx(sent[stamp], rel=1e-12)


def test_a_live_page_gets_the_curves_behind_once_a_second_and_complete(tmp_path):
    session, path = Session(3.0), tmp_path / "live.rrd"
    with Sink("rrd", CONFIG, "test", path, live=True) as sink:
        scene = Scene(CONFIG, sink.stream, sink.lay_out, everything=False, live=True)
        for k in range(0, len(session.messages), 300):
            scene.curves(decode(session.messages[k : k + 300]))
    saved = read(path)
    newest = max(m.stamp_ns for m in session.of(LEDGER))
    for entity, rate in (("/energy/slave/joint_0/credit", 20), ("/elongation/tendon_0", 100)):
        stamps = np.sort(list(saved[entity]["Scalars:scalars"]))
        assert newest - 1_300_000_000 < stamps[-1]
        assert np.diff(stamps).max() <= 2e9 / rate, "rows between two times are missing"
    front = max(saved["/tension/tendon_0/in"]["Scalars:scalars"])
    assert front >= max(saved["/elongation/tendon_0"]["Scalars:scalars"])


def test_the_interval_is_one_area_from_its_low_to_its_high_end(session, saved):
    sent = {m.stamp_ns: (m.force_low[0], m.force_high[0]) for m in session.of(STATE)}
    area = sorted(saved["/force/joint_0/interval"]["Scalars:scalars"].items())
    (style,) = saved["/force/joint_0/interval"]["SeriesLines:names"][None]
    assert style == "interval"
    assert len(area) >= 2 * CONFIG.rate_hz.state - 4
    for (stamp, (low,)), (later, (high,)) in zip(area[::2], area[1::2], strict=True):
        assert (low, high) == sent[stamp]
        assert stamp < later < stamp + 1e9 / CONFIG.rate_hz.state


def test_one_scheme_of_names_is_used_in_all_plots_of_a_joint():
    words = {"measured", "estimated", "commanded", "true"}
    for topic in (TENDONS, STATE, COMMAND, HAND):
        for group in CURVES[topic]:
            assert group.over == "sender" or {curve.name for curve in group.curves} <= words


def test_a_sensor_that_is_not_there_draws_nothing(saved):
    assert "/tension/tendon_1/out_true" not in saved
    assert "/displacement/tendon_0/out_true" not in saved
    assert "/displacement/tendon_1/in" not in saved
    assert "/displacement/tendon_0/in" in saved


def test_only_tendons_and_joints_in_use_are_drawn(saved):
    assert not [name for name in saved if "tendon_2" in name or "joint_1" in name]


def test_tendons_are_called_by_joint_and_side(saved):
    assert saved["/tension/tendon_1/in"]["SeriesLines:names"][None] == ["measured 1b"]


# states and events


def test_events_are_in_the_log(saved):
    assert list(saved["/log"]["TextLog:text"].values()) == [
        ["14:13:20.300  slave: load cell silent"]
    ]
    assert list(saved["/log"]["TextLog:level"].values()) == [["ERROR"]]


def test_every_change_of_state_is_in_its_lane_and_nothing_else(session, saved):
    lane = saved["/state/slave"]["StateChange:state"]
    assert {stamp: name for stamp, (name,) in lane.items()} == {
        T0: "ready",
        T0 + 400_000_000: "engaged",
    }


def test_a_role_and_a_state_of_the_future_are_shown(tmp_path):
    session = Session(0)
    session.add(EVENT, Event(role=99, state=99, text=encode_text("hello")), T0)
    session.add(STATE, SlaveState(state=99, joints=1), T0)
    file = save(session.messages, tmp_path / "s.rrd")
    assert ["14:13:20.000  role_99: hello"] in file["/log"]["TextLog:text"].values()
    assert list(file["/state/slave"]["StateChange:state"].values()) == [["fault"]]


def test_an_emergency_stop_stands_out(tmp_path):
    session = Session(0)
    session.add(STOP, STOP.message(role=5, action=0, text=encode_text("by hand")), T0)
    file = save(session.messages, tmp_path / "s.rrd")
    assert ["CRITICAL"] in file["/log"]["TextLog:level"].values()
    assert ["14:13:20.000  remote: stop: by hand"] in file["/log"]["TextLog:text"].values()


@pytest.mark.parametrize("state", State)
def test_every_state_has_a_colour(state):
    from teleop.view.colours import STATES

    assert state.name.lower() in STATES


# layout


def views_of(path):
    """Return the names of the views in the blueprints of a file."""
    file = reader(path)
    names = []
    for chunk in (c for entry in file.blueprints() for c in file.stream(store=entry)):
        table = chunk.to_record_batch()
        for name in table.schema.names:
            if name.endswith(":display_name"):
                names += [value[0] for value in table.column(name).to_pylist() if value]
    return set(names)


@pytest.mark.parametrize(
    ("layout", "shown", "hidden"),
    [
        ("surgeon", {"State"}, {"Log", "T(x) 1"}),
        (
            "experiment",
            {
                "T(x) 1",
                "Loop 1",
                "2",
                "Tension [N] at the housing (measured) and at the tip, joint 1",
                "Force at the tip [N], positive against pulling, joint 1",
                "Tip [mm], positive pulled in, joint 1",
                "Hand [N], joint 1",
                "Elongation [mm], joint 1",
                "Motor [mm], joint 1",
                "Log",
                "Energy [mJ]",
                "Delays [ms]",
                "Rate [Hz]",
                "Latency [ms]",
                "Age [ms]",
                "Lost",
                "State",
            },
            set(),
        ),
        ("presentation", set(), {"State", "Log", "T(x) 1"}),
    ],
)
def test_a_layout_has_its_views_for_each_joint(layout, shown, hidden, tmp_path):
    config = ViewConfig(layout=layout)
    with Sink("rrd", config, "test", tmp_path / "s.rrd", live=False) as sink:
        sink.lay_out({0: [0, 1], 1: [2, 3]})
    views = views_of(tmp_path / "s.rrd")
    assert shown <= views
    assert not hidden & views
    assert any("thick: slides" in name for name in views) == (layout != "surgeon")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_layout_can_be_made_for_one_joint_and_for_eight(layout):
    config = ViewConfig(layout=layout)
    for joints in (0, 1, 8):
        build_blueprint(config, {joint: [2 * joint, 2 * joint + 1] for joint in range(joints)})


def test_a_sheath_is_drawn_again_only_if_it_changed(session, tmp_path):
    with Sink("rrd", CONFIG, "test", tmp_path / "s.rrd", live=False) as sink:
        scene = Scene(CONFIG, sink.stream)
        for _ in range(5):
            scene.send(decode(session.messages[:12]))
    drawn = [
        chunk
        for chunk in reader(tmp_path / "s.rrd").stream()
        if chunk.entity_path == "/scene/tendon_0/tube" and chunk.is_static
    ]
    assert len(drawn) <= 2  # once alone, once when the other tendon was heard of
