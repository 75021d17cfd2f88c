"""A page of the web view that is opened late, opened again, or beside another.

Each shows what one does that was there from the start, although the server has dropped the oldest
data by then: its memory is bounded, and here so small that two minutes overflow it.
"""

from dataclasses import replace

import pytest

from teleop.app.launch.supervisor import wait_for
from teleop.messages import Hand, SlaveState
from teleop.session import Reason, State
from teleop.topics import HAND, STATE
from teleop.view.batch import decode
from teleop.view.colours import STATES
from teleop.view.scene import Scene
from teleop.view.sinks import Sink
from tests import browser
from tests.system.processes import free_ports
from tests.system.view_pictures import APPEARS_S, BANNER, EACH_VIEW, SCENE, engaged, pixels
from tests.teleop.view_session import CONFIG, SENDER, T0, Session

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser.program() is None, reason="no Chromium on this machine"),
]

SERVER_MB = 16
START_S, TURN_S, TURNS = 0.4, 0.6, 240  # the part of the session that is engaged, again and again
END = T0 + round((START_S + TURNS * TURN_S) * 1e9)
MESSAGES = Session(1.0).messages


def feed(scene):
    """Send more than two minutes at once: the start with the sheaths, then what moves."""
    first = round(len(MESSAGES) * START_S)
    scene.send(decode(MESSAGES[:first]))
    moving = decode(MESSAGES[first:])
    for turn in range(TURNS):
        later = {topic: rows.copy() for topic, rows in moving.items()}
        for rows in later.values():
            rows["stamp_ns"] += round(turn * TURN_S * 1e9)
        scene.send(later)


@pytest.fixture(scope="module")
def minute(tmp_path_factory):
    """A view of a session that began two minutes ago: its address, and its scene."""
    ports = dict(zip(("web_port", "grpc_port"), free_ports(2), strict=True))
    config = replace(CONFIG, server_memory_mb=SERVER_MB, **ports)
    copy = tmp_path_factory.mktemp("view") / "copy.rrd"
    with Sink("web", config, "test", copy, live=True) as sink:
        scene = Scene(config, sink.stream, sink.lay_out)
        feed(scene)
        sink.stream.flush()
        assert copy.stat().st_size > 1.5e6 * SERVER_MB
        yield sink.lines[0].removeprefix("Web view: ") + "?renderer=webgl", scene, sink.stream


def shows_everything(picture):
    """Check that a picture shows what each view is for, and the tubes of the scene."""
    for box, colour in EACH_VIEW:
        assert pixels(picture, box, colour, 40) > 20, f"{colour:08x} is not in {box}"
    left, top, right, bottom = SCENE
    tubes = picture[top:bottom, left:right].astype(int)
    assert (tubes.max(axis=-1) - tubes.min(axis=-1) > 60).sum() > 2000


def test_a_page_that_is_opened_minutes_late_and_reloaded_shows_everything(minute):
    address, _, _ = minute
    with browser.Browser() as chromium:
        for _ in range(2):
            chromium.open(address)
            shows_everything(chromium.settle(APPEARS_S, appeared=engaged))


def test_two_pages_at_once_show_the_same_and_follow_the_session(minute):
    address, scene, stream = minute
    with browser.Browser() as one, browser.Browser() as other:
        for chromium in (one, other):
            chromium.open(address)
        for chromium in (one, other):
            shows_everything(chromium.settle(APPEARS_S, appeared=engaged))
        held = {"state": State.HOLDING, "reason": Reason.PEER_ENDED, "joints": 1}
        scene.send(
            decode(
                [
                    (STATE, SlaveState(**held).pack(SENDER, 10**6, END)),
                    (HAND, Hand(**held).pack(SENDER, 10**6, END)),
                ]
            )
        )
        stream.flush()
        for chromium in (one, other):
            assert wait_for(
                lambda shown=chromium: pixels(shown.picture(), BANNER, STATES["holding"]) > 10_000,
                APPEARS_S,
                1.0,
            )
