"""A page of the web view that is opened late, opened again, or beside another.

Each shows what one does that was there from the start, although the server has dropped the oldest
data by then: its memory is bounded.
"""

from dataclasses import replace

import numpy as np
import pytest
import rerun as rr

from teleop.launch.supervisor import wait_for_condition
from teleop.messages.messages import Hand, SlaveState
from teleop.messages.topics import HAND, STATE
from teleop.session.state_machine import Reason, State
from teleop.view.colours import STATES
from teleop.view.columns import Sender, decode
from teleop.view.scene import Scene
from teleop.view.sinks import Sink
from tests import browser
from tests.system.view_pictures import APPEARS_S, BANNER, EACH_VIEW, SCENE, pixels
from tests.teleop.view_session import CONFIG, SENDER, T0, Session

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser.program() is None, reason="no Chromium on this machine"),
]

SERVER_MB = 16
START_S, TURN_S, TURNS = 0.4, 0.6, 20  # the part of the session that is engaged, again and again
END = T0 + round((START_S + TURNS * TURN_S) * 1e9)
MESSAGES = Session(1.0).messages


def overflow(sink):
    """Send twice what the server keeps, so that it drops everything before but static data."""
    noise = np.random.default_rng(0).integers(0, 256, 1_000_000, np.uint8)
    megabyte = rr.AnyValues.columns(noise=noise).partition([len(noise)])
    for _ in range(2 * SERVER_MB):
        Sender(sink.stream).columns_at("noise", np.array([T0]), megabyte)
        sink.publish()


def feed(scene, sink):
    """Send the start with the sheaths, which the server drops, then twelve seconds of motion."""
    first = round(len(MESSAGES) * START_S)
    scene.send(decode(MESSAGES[:first]))
    overflow(sink)
    moving = decode(MESSAGES[first:])
    for turn in range(TURNS):
        later = {topic: rows.copy() for topic, rows in moving.items()}
        for rows in later.values():
            rows["stamp_ns"] += round(turn * TURN_S * 1e9)
        scene.send(later)
        sink.publish()


def hidden(picture):
    """Return what a picture lacks of what each view is for, and of the tubes of the scene."""
    lacks = [
        f"{colour:08x} in {box}"
        for box, colour in EACH_VIEW
        if pixels(picture, box, colour, 40) <= 20
    ]
    left, top, right, bottom = SCENE
    tubes = picture[top:bottom, left:right].astype(int)
    tubes_shown = (tubes.max(axis=-1) - tubes.min(axis=-1) > 60).sum() > 2000
    return lacks if tubes_shown else [*lacks, "tubes"]


def require_everything(page):
    """Wait until a page shows everything."""
    if not wait_for_condition(lambda: not hidden(page.picture()), APPEARS_S, 1.0):
        pytest.fail(f"not shown: {', '.join(hidden(page.picture()))}")


def test_pages_that_are_opened_late_show_everything_and_follow_the_session():
    config = replace(CONFIG, server_memory_mb=SERVER_MB)
    with Sink("web", config, "test", None, live=True) as sink, browser.Browser() as one:
        scene = Scene(config, sink.stream, sink.lay_out)
        feed(scene, sink)
        address = sink.lines[0].removeprefix("Web view: ") + "?renderer=webgl&layout=full"
        one.open(address)
        require_everything(one)
        with browser.Browser() as other:
            for page in (one, other):  # one is reloaded
                page.open(address)
            for page in (one, other):
                require_everything(page)
            held = {"state": State.HOLDING, "reason": Reason.PEER_ENDED, "joints": 1}
            scene.send(
                decode(
                    [
                        (STATE, SlaveState(**held).pack(SENDER, 10**6, END)),
                        (HAND, Hand(**held).pack(SENDER, 10**6, END)),
                    ]
                )
            )
            sink.publish()
            for page in (one, other):
                assert wait_for_condition(
                    lambda shown=page: pixels(shown.picture(), BANNER, STATES["holding"]) > 10_000,
                    APPEARS_S,
                    1.0,
                )
