"""What a Rerun file holds after a session, read back with Rerun's own reader."""

import math

import numpy as np
import pytest

from teleop.messages.messages import (
    MAX_JOINTS,
    MAX_TENDONS,
    PHASE_NAMES,
    PROFILE_POINTS,
    Event,
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
    LEDGER,
    PROFILE,
    REPORT,
    SHEATH,
    STATE,
    STOP,
    TENDONS,
)
from teleop.view.colours import PHASES, to_rgba
from teleop.view.columns import decode
from teleop.view.config import LAYOUTS, ViewConfig
from teleop.view.layouts import build_blueprint
from teleop.view.scene import Scene
from teleop.view.scene_geometry import PIECES, SEGMENTS, Shape, build_stage
from teleop.view.sinks import Sink
from tests.teleop.view.made_session import CONFIG, T0, Session, read, save


@pytest.fixture(scope="module")
def placed():
    shape = Shape(0, (0.3, 0.5), (math.inf, 0.2))
    return build_stage({0: shape, 1: shape}, CONFIG)


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


# the tension along the sheath, and the tubes


def test_profile_and_front_arrive_as_they_were_sent(session, saved, placed):
    whole = np.linspace(0, 0.8, SEGMENTS * PIECES + 1)
    for tendon in (0, 1):
        sent = {m.stamp_ns: m for m in session.of(PROFILE) if m.tendon == tendon}
        shown = saved[f"/profile/tendon_{tendon}/tension"]["tension"]
        marks = saved[f"/scene/tendon_{tendon}/tube"]["Points3D:positions"]
        assert len(shown) >= 20
        for stamp, tension in shown.items():
            np.testing.assert_allclose(tension, sent[stamp].tension, atol=1e-6)
            line = placed.lines[tendon]
            there = [np.interp(sent[stamp].front, whole, line[:, axis]) for axis in range(3)]
            np.testing.assert_allclose(marks[stamp][0], there, atol=1e-6)


def test_the_tube_has_the_colour_of_its_tension(session, saved):
    sent = {m.stamp_ns: np.array(m.tension) for m in session.of(PROFILE) if m.tendon == 0}
    shown = saved["/scene/tendon_0/tube"]["Capsules3D:colors"]
    assert len(shown) >= 20
    for stamp, colours in shown.items():
        middle = [(a + b) / 2 for a, b in zip(sent[stamp], sent[stamp][1:], strict=False)]
        expected = [int(to_rgba(np.array([t]), CONFIG.tension_scale_N)[0]) for t in middle]
        assert colours == expected


def test_a_front_that_is_not_known_is_not_drawn(tmp_path):
    session = Session(0.05)
    lost = TensionProfile(length=0.8, front=math.nan, tension=(math.nan,) * PROFILE_POINTS)
    session.add(PROFILE, lost, T0 + 60_000_000)
    file = save(session.messages, tmp_path / "lost.rrd")
    assert not file["/scene/tendon_0/tube"]["Points3D:positions"][T0 + 60_000_000]
    grey = file["/scene/tendon_0/tube"]["Capsules3D:colors"][T0 + 60_000_000]
    assert set(grey) == {0x808080FF}


# joint, tip and hand


def test_the_arrow_at_the_tip_is_the_force_against_pulling(session, saved, placed):
    sent = {m.stamp_ns: m for m in session.of(STATE)}
    arrows = saved["/scene/joint_0/force"]
    lever = placed.joints[0]
    lengths, forces = [], []
    for stamp, (vector,) in arrows["Arrows3D:vectors"].items():
        travel, force = sent[stamp].position[0], sent[stamp].force[0]
        (origin,) = arrows["Arrows3D:origins"][stamp]
        np.testing.assert_allclose(origin, lever.compute_tip(np.array([travel]))[0], atol=1e-5)
        onward = lever.compute_direction(np.array([travel]))[0]
        assert np.dot(vector, onward) == pytest.approx(-np.linalg.norm(vector), abs=1e-5)
        lengths.append(np.linalg.norm(vector))
        forces.append(force)
    np.testing.assert_allclose(lengths, np.array(forces) * max(lengths) / max(forces), atol=1e-5)


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
        ("/tension/tendon_0/out_true", TENDONS, lambda m: m.bench_distal_tension[0]),
        ("/force/joint_0/tip", STATE, lambda m: m.force[0]),
        ("/position/joint_0/asked", COMMAND, lambda m: m.position[0] * 1e3),
        ("/energy/slave/joint_0/dissipated", LEDGER, lambda m: m.dissipated[0] * 1e3),
        ("/latency/slave/late", REPORT, lambda m: m.lateness_max_ns / 1e6),
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
            scene.draw_curves(decode(session.messages[k : k + 300]))
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


def test_what_is_not_there_draws_nothing(saved):
    assert not [name for name in saved if "tendon_2" in name or "joint_1" in name]
    assert "/tension/tendon_1/out_true" not in saved
    assert "/displacement/tendon_0/out_true" not in saved
    assert "/displacement/tendon_1/in" not in saved
    assert "/displacement/tendon_0/in" in saved


# states and events


def test_events_of_any_role_are_in_the_log_and_an_emergency_stop_stands_out(tmp_path):
    session = Session(0)
    session.add(EVENT, Event(role=99, state=99, text=encode_text("hello")), T0)
    session.add(STATE, SlaveState(state=99, joints=1), T0)
    session.add(STOP, STOP.message(role=5, action=0, text=encode_text("by hand")), T0 + 1_000_000)
    file = save(session.messages, tmp_path / "s.rrd")
    texts, levels = (file["/log"][f"TextLog:{part}"] for part in ("text", "level"))
    assert {stamp - T0: (*texts[stamp], *levels[stamp]) for stamp in texts} == {
        0: ("14:13:20.000  role_99: hello", "ERROR"),
        1_000_000: ("14:13:20.001  remote: stop: by hand", "CRITICAL"),
        300_000_000: ("14:13:20.300  slave: load cell silent", "ERROR"),
    }
    assert list(file["/state/slave"]["StateChange:state"].values()) == [["fault"]]


def test_every_change_of_state_is_in_its_lane_and_nothing_else(session, saved):
    lane = saved["/state/slave"]["StateChange:state"]
    assert {stamp: name for stamp, (name,) in lane.items()} == {
        T0: "ready",
        T0 + 400_000_000: "engaged",
    }


# layout


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("joints", [0, 2, 8])
def test_a_layout_has_a_blueprint_for_any_number_of_joints(layout, joints):
    tendons = {joint: [2 * joint, 2 * joint + 1] for joint in range(joints)}
    assert build_blueprint(ViewConfig(layout=layout), tendons).root_container.contents
