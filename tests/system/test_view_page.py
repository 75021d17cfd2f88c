"""The web view in a real browser: the page appears, stays local, and says when it is late."""

import urllib.parse
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from studies.testbed import browser
from studies.testbed.processes import find_free_ports, wait_for_condition
from teleop.view.colours import STATES
from teleop.view.columns import decode
from teleop.view.scene import Scene
from teleop.view.sinks import Sink
from tests.teleop.view.made_session import CONFIG, Session

pytestmark = [
    pytest.mark.slow,  # minutes of drawing by software; test_view_access opens a page of it too
    pytest.mark.skipif(browser.find_program() is None, reason="no Chromium on this machine"),
]

APPEARS_S = 240.0  # on a busy machine; a quiet one takes a tenth
LOST = 0xD55E00FF  # of the strip that says that the view is interrupted
MESSAGES = Session(1.0).messages


def pixels(picture, box, colour, tolerance=24):
    """Return how many pixels of a box have a colour, near enough."""
    left, top, right, bottom = box
    part = picture[top:bottom, left:right].astype(int)
    wanted = np.array([(colour >> shift) & 0xFF for shift in (24, 16, 8)])
    return int((np.abs(part - wanted).max(axis=-1) <= tolerance).sum())


def green(picture):
    """Return how many pixels have the colour of the banner of an engaged session."""
    return pixels(picture, (0, 0, picture.shape[1], picture.shape[0]), STATES["engaged"], 30)


def engaged(picture):
    """Return whether the banner says so: the newest data have arrived."""
    return green(picture) > 0.02 * picture.shape[0] * picture.shape[1]


@pytest.fixture(scope="module")
def chromium():
    """One browser for all pages: it compiles what draws them once."""
    with browser.Browser() as chromium:
        yield chromium


@contextmanager
def shown(chromium, config):
    """Show the session's messages in a browser; yields its picture and the address."""
    with Sink("web", config, "test", None, live=False) as sink:
        scene = Scene(config, sink.stream, sink.lay_out)
        for start in range(0, len(MESSAGES), 500):
            scene.send(decode(MESSAGES[start : start + 500]))
            sink.publish()
        address = sink.lines[0].removeprefix("Web view: ")
        chromium.open(address + "?renderer=webgl&layout=full")
        yield chromium.settle(APPEARS_S, appeared=engaged), address


@pytest.fixture(scope="module")
def page(chromium):
    with shown(chromium, CONFIG) as page:
        yield page


def test_the_browser_asked_only_this_machine_and_was_refused_the_rest(chromium, page):
    _, address = page
    ours = urllib.parse.urlsplit(address).hostname
    assert ours == "127.0.0.1"
    assert not chromium.complaints
    reached = {urllib.parse.urlsplit(url).hostname for url in chromium.answered}
    assert reached <= {ours, None, ""}


def test_a_page_says_how_old_what_it_shows_is(chromium):
    config = replace(CONFIG, layout="surgeon")
    chromium.emulate(1280, 800, "light")
    with Sink("web", config, "test", None, live=True) as sink:
        scene = Scene(config, sink.stream, sink.lay_out)
        scene.send(decode(MESSAGES))
        sink.publish()
        sink.follow(lambda: scene.newest_ns + 12_000_000_000, scene.show_panel)
        chromium.open(sink.lines[0].removeprefix("Web view: ") + "?renderer=webgl&layout=full")
        strip = (0, 0, 1280, 60)
        assert wait_for_condition(
            lambda: pixels(chromium.picture(), strip, LOST) > 5000, APPEARS_S, 1.0
        )
        assert sink.behind_s == pytest.approx(12.0, abs=0.1)
        sink.follow(lambda: scene.newest_ns, scene.show_panel)
        assert wait_for_condition(lambda: pixels(chromium.picture(), strip, LOST) == 0, 60)


def test_the_page_comes_back_when_another_view_serves_it(chromium):
    """Two views one after the other at the same address; the second shows another layout."""
    ports = dict(zip(("web_port", "grpc_port"), find_free_ports(2), strict=True))
    config = replace(CONFIG, layout="surgeon", **ports)
    chromium.emulate(1280, 800, "light")
    for layout in ("presentation", "surgeon"):
        with Sink("web", replace(config, layout=layout), "test", None, live=False) as sink:
            scene = Scene(replace(config, layout=layout), sink.stream, sink.lay_out)
            scene.send(decode(MESSAGES))
            sink.stream.flush()
            if layout == "presentation":
                chromium.open(sink.lines[0].removeprefix("Web view: ") + "?renderer=webgl")
                before = chromium.settle(APPEARS_S)
                assert green(before) < 100_000
            else:
                assert wait_for_condition(
                    lambda: green(chromium.picture()) > 100_000, APPEARS_S, 1.0
                )
        if layout == "presentation":  # nobody serves it
            lost = wait_for_condition(
                lambda: pixels(chromium.picture(), (0, 0, 1280, 60), LOST) > 5000, 60
            )
            assert lost
