"""The web view in a real browser: the page appears, and each view shows what it should.

The browser prefers a light theme, which the page must not follow; the dark one is a slow test.
"""

import urllib.parse
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from teleop.app.launch.supervisor import wait_for
from teleop.view.batch import decode
from teleop.view.colours import ESTIMATE, HOUSING, PHASES, STATES, TRUTH, rgba
from teleop.view.scene import Scene
from teleop.view.sinks import Sink
from tests import browser
from tests.system.processes import free_ports
from tests.teleop.view_session import CONFIG, Session

pytestmark = pytest.mark.skipif(browser.program() is None, reason="no Chromium on this machine")

APPEARS_S = 240.0
LOST = 0xD55E00FF  # of the strip that says that the view is interrupted
# left, top, right, bottom [pixels] of what the experiment layout shows at 1280 by 800
BANNER = (0, 0, 640, 90)
SCENE = (0, 120, 640, 475)
PROFILE = (0, 505, 318, 770)
LOOP = (350, 560, 505, 720)  # without the names of the phases
TENSION = (645, 30, 1130, 225)  # left of the legends
FORCE = (645, 270, 1130, 425)


def rgb(colour):
    return np.array([(colour >> shift) & 0xFF for shift in (24, 16, 8)])


def pixels(picture, box, colour, tolerance=24):
    """Return how many pixels of a box have a colour, near enough."""
    left, top, right, bottom = box
    part = picture[top:bottom, left:right].astype(int)
    return int((np.abs(part - rgb(colour)).max(axis=-1) <= tolerance).sum())


MESSAGES = Session(1.0).messages


@contextmanager
def shown(config, theme, width=1280, height=800):
    """Show the session's messages in a browser; yields browser, picture and address."""
    with (
        Sink("web", config, "test", None, live=False) as sink,
        browser.Browser(width, height, theme) as chromium,
    ):
        scene = Scene(config, sink.stream, sink.lay_out)
        for start in range(0, len(MESSAGES), 500):
            scene.send(decode(MESSAGES[start : start + 500]))
        sink.stream.flush()
        address = sink.lines[0].removeprefix("Web view: ")
        chromium.open(address + "?renderer=webgl")
        yield chromium, chromium.settle(APPEARS_S), address


@pytest.fixture(scope="module")
def page():
    with shown(CONFIG, "light") as page:
        yield page


def is_dark(picture):
    """Return whether most of the page is as dark as the background of the view."""
    return np.median(picture.max(axis=-1)) < 60


def test_the_page_is_dark_in_a_browser_that_prefers_light(page):
    _, picture, _ = page
    assert is_dark(picture)


@pytest.mark.slow
@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("size", [(1280, 800), (1920, 1080)])
@pytest.mark.parametrize("layout", ["surgeon", "experiment"])
def test_state_and_force_are_seen_in_both_themes_and_sizes(layout, size, theme):
    with shown(replace(CONFIG, layout=layout), theme, *size) as (_, picture, _):
        assert picture.shape[:2] == size[::-1]
        whole = (0, 0, *size)
        assert green(picture) > (0.1 if layout == "surgeon" else 0.02) * size[0] * size[1]
        assert pixels(picture, whole, ESTIMATE, 30) > 1000
        assert is_dark(picture)


def test_the_page_is_not_blank(page):
    _, picture, _ = page
    assert picture.shape == (800, 1280, 3)
    assert picture.std() > 10
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 500


def test_the_scene_shows_the_colour_scale_from_end_to_end(page):
    _, picture, _ = page
    levels = rgba(np.linspace(0.05, 0.95, 10) * CONFIG.tension_scale_N, CONFIG.tension_scale_N)
    for colour in levels:
        assert pixels(picture, SCENE, int(colour), 12) > 5, f"{int(colour):08x} is missing"


def test_the_scene_shows_tubes_beside_the_scale(page):
    _, picture, _ = page
    tubes = picture[65:475, 60:520].astype(int)
    assert (tubes.max(axis=-1) - tubes.min(axis=-1) > 60).sum() > 2000


@pytest.mark.parametrize(
    ("box", "colour"),
    [
        (PROFILE, ESTIMATE),
        (LOOP, PHASES[4]),
        (TENSION, ESTIMATE),
        (TENSION, TRUTH),
        (TENSION, HOUSING),
        (FORCE, ESTIMATE),
        (BANNER, STATES["engaged"]),
    ],
)
def test_each_view_shows_what_it_is_for(page, box, colour):
    _, picture, _ = page
    assert pixels(picture, box, colour, 40) > 20


def test_the_browser_asked_only_this_machine_and_was_refused_the_rest(page):
    chromium, _, address = page
    ours = urllib.parse.urlsplit(address).hostname
    assert ours == "127.0.0.1"
    assert not chromium.complaints
    reached = {urllib.parse.urlsplit(url).hostname for url in chromium.answered}
    assert reached <= {ours, None, ""}


def test_the_picture_can_be_saved(page, tmp_path):
    chromium, _, _ = page
    file: Path = tmp_path / "page.png"
    chromium.save(file)
    assert file.stat().st_size > 10_000


def green(picture):
    """Return how many pixels have the colour of the banner of an engaged session."""
    return pixels(picture, (0, 0, picture.shape[1], picture.shape[0]), STATES["engaged"], 30)


@pytest.mark.slow  # half a minute of a browser
def test_the_page_comes_back_when_another_view_serves_it():
    """Two views one after the other at the same address; the second shows another layout."""
    ports = dict(zip(("web_port", "grpc_port"), free_ports(2), strict=True))
    config = replace(CONFIG, layout="surgeon", **ports)
    with browser.Browser() as chromium:
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
                    assert wait_for(lambda: green(chromium.picture()) > 100_000, APPEARS_S, 1.0)
            if layout == "presentation":  # nobody serves it
                lost = wait_for(
                    lambda: pixels(chromium.picture(), (0, 0, 1280, 60), LOST) > 5000, 60
                )
                assert lost
