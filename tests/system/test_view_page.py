"""The web view in a real browser: the page appears, and each view shows what it should.

The browser prefers a light theme, which the page must not follow.
"""

import urllib.parse
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from studies.testbed import browser
from studies.testbed.processes import free_ports
from teleop.launch.supervisor import wait_for_condition
from teleop.view.colours import to_rgba
from teleop.view.columns import decode
from teleop.view.scene import Scene
from teleop.view.sinks import Sink
from tests.system.view_pictures import (
    APPEARS_S,
    EACH_VIEW,
    LOST,
    SCENE,
    engaged,
    green,
    is_dark,
    pixels,
)
from tests.teleop.view_session import CONFIG, Session

pytestmark = [
    pytest.mark.slow,  # minutes of drawing by software; test_view_access opens a page of it too
    pytest.mark.skipif(browser.program() is None, reason="no Chromium on this machine"),
]

MESSAGES = Session(1.0).messages


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


def test_each_view_shows_what_it_is_for_on_a_dark_page(page):
    picture, _ = page
    assert is_dark(picture)  # though the browser prefers light
    for box, colour in EACH_VIEW:
        assert pixels(picture, box, colour, 40) > 20, (box, f"{colour:08x}")
    levels = to_rgba(np.linspace(0.05, 0.95, 10) * CONFIG.tension_scale_N, CONFIG.tension_scale_N)
    for colour in levels:  # of the scale, from end to end
        assert pixels(picture, SCENE, int(colour), 12) > 5, f"{int(colour):08x} is missing"
    tubes = picture[65:475, 60:520].astype(int)
    assert (tubes.max(axis=-1) - tubes.min(axis=-1) > 60).sum() > 2000


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
    ports = dict(zip(("web_port", "grpc_port"), free_ports(2), strict=True))
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
