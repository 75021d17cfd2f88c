"""The panel: large letters, the state of a session, the force with its limit, the link."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.messages.messages import MAX_JOINTS, Command, Hand, LoopReport, SlaveState, pad_values
from teleop.messages.topics import COMMAND, HAND, REPORT, STATE, Role
from teleop.session.state_machine import Reason, State
from teleop.view.colours import STATES
from teleop.view.columns import decode
from teleop.view.config import ViewConfig
from teleop.view.feed import Pacing
from teleop.view.panel import (
    Banner,
    LinkCounts,
    build_banner,
    compute_link_quality,
    format_link_parts,
)
from teleop.view.panel_layout import _GLYPHS
from teleop.view.scene import Scene
from teleop.view.sinks import Sink
from tests.teleop.view.made_session import T0, Session, read

SURGEON = ViewConfig(layout="surgeon", tension_scale_N=10.0)


def test_every_letter_of_a_reason_and_a_state_has_a_glyph():
    words = " ".join([reason.text for reason in Reason] + [state.name for state in State])
    assert set(words.upper()) - set(_GLYPHS) - {" "} == set()


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
    quality = compute_link_quality(counts, counts, 0.5, no_reception=True)
    assert format_link_parts(quality, 0.1, []) == ("no link", "", "", "")


def test_the_link_is_as_good_as_its_worse_way():
    before = {Role.MASTER: LinkCounts(1000, 0), Role.SLAVE: LinkCounts(1000, 5)}
    now = {Role.MASTER: LinkCounts(1500, 0), Role.SLAVE: LinkCounts(1475, 30)}
    quality = compute_link_quality(before, now, 0.5)
    assert quality.word == "poor"
    assert quality.loss == pytest.approx(0.05)
    assert compute_link_quality(now, now, None).word == "good"


# the panel


def draw(path, *blocks, silent_ns=0):
    """Return what the panel shows of blocks of messages, and then of a silence."""
    with Sink("rrd", SURGEON, "test", path, live=False) as sink:
        scene = Scene(SURGEON, sink.stream, sink.lay_out)
        for block in blocks:
            scene.send(decode(block.messages))
        if silent_ns:
            scene.show_silence(silent_ns)
    return read(path)


def block(stamp, *messages):
    session = Session(0)
    for topic, message in messages:
        session.add(topic, message, stamp)
    return session


def slave(state, **fields):
    return STATE, SlaveState(state=state, joints=1, **fields)


def master(state):
    return HAND, Hand(state=state, joints=1)


def received(count):
    return REPORT, LoopReport(role=Role.MASTER, received=count)


FORCE = {"force": pad_values((6.0,), MAX_JOINTS)}
AREA = "/panel/banner/area"


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A session that engages at 0.5 s and falls silent after a second."""
    session = Session(0)
    for k in range(100):
        stamp = T0 + k * 10_000_000
        state = State.READY if k < 50 else State.ENGAGED
        limit = COMMAND, Command(force_max=12.0 if k < 99 else 0.0)  # off
        for topic, message in (master(state), slave(state, **FORCE), limit):
            session.add(topic, message, stamp)
    session.add(*received(100), stamp)
    path = tmp_path_factory.mktemp("panel") / "panel.rrd"
    return draw(path, session, silent_ns=2_000_000_000)


def test_the_banner_follows_the_state_and_says_when_nothing_comes(drawn):
    colours = drawn[AREA]["LineStrips2D:colors"]
    states = [STATES[name] for name in ("ready", "engaged", "no data")]
    assert [values[0] for _, values in sorted(colours.items())] == states
    assert sorted(colours) == [T0, T0 + 500_000_000, T0 + 990_000_000 + 2_000_000_000]


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
    blocks = []
    for k in range(30):
        sent = [master(State.ENGAGED)]
        sent += [slave(State.ENGAGED, **FORCE)] * (k < 10)
        sent += [received(100 * min(k, 10))] * (k % 5 == 0)
        blocks.append(block(T0 + k * 100_000_000, *sent))
    entities = draw(tmp_path / "panel.rrd", *blocks)
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
    blocks = [
        block(T0 + k * 100_000_000, slave(state), *[master(State.READY)] * (k < 10))
        for k in range(30)
    ]
    colours = draw(tmp_path / "panel.rrd", *blocks)[AREA]["LineStrips2D:colors"]
    assert colours[max(colours)][0] == STATES[shown]


def test_a_page_is_sent_only_what_its_layout_shows_and_a_file_everything(tmp_path):
    sent = []
    for whole in (False, True):
        path = tmp_path / f"{whole}.rrd"
        with Sink("rrd", SURGEON, "test", path, live=False) as sink:
            scene = Scene(SURGEON, sink.stream, sink.lay_out, everything=whole)
            scene.send(decode(Session(0.1).messages))
        sent.append({entity.split("/")[1] for entity in read(path)} - {"__properties"})
    page, file = sent
    assert page == {"panel"}
    assert {"panel", "scene", "profile", "loop", "tension", "force", "state", "log"} <= file


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
