"""The web view in a real browser: the page appears, and each view shows what it should."""

import urllib.parse
from pathlib import Path

import numpy as np
import pytest

from teleop.view.batch import decode
from teleop.view.colours import ESTIMATE, HOUSING, PHASES, STATES, rgba
from teleop.view.scene import Scene
from teleop.view.sinks import Sink
from tests import browser
from tests.teleop.view_session import CONFIG, Session

pytestmark = pytest.mark.skipif(browser.program() is None, reason="no Chromium on this machine")

APPEARS_S = 240.0
# left, top, right, bottom [pixels] of what the experiment layout shows at 1280 by 800
SCENE = (0, 65, 640, 475)
PROFILE = (0, 505, 318, 770)
LOOP = (350, 560, 505, 720)  # without the names of the phases
TENSION = (645, 65, 1280, 190)
FORCE = (645, 240, 1280, 352)
STATE = (645, 665, 1280, 770)


def rgb(colour):
    return np.array([(colour >> shift) & 0xFF for shift in (24, 16, 8)])


def pixels(picture, box, colour, tolerance=24):
    """Return how many pixels of a box have a colour, near enough."""
    left, top, right, bottom = box
    part = picture[top:bottom, left:right].astype(int)
    return int((np.abs(part - rgb(colour)).max(axis=-1) <= tolerance).sum())


@pytest.fixture(scope="module")
def page():
    with Sink("web", CONFIG, "test", None, live=False) as sink, browser.Browser() as chromium:
        scene = Scene(CONFIG, sink.stream, sink.lay_out)
        messages = Session(1.0).messages
        for start in range(0, len(messages), 500):
            scene.send(decode(messages[start : start + 500]))
        sink.stream.flush()
        address = sink.lines[0].removeprefix("Web view: ")
        chromium.open(address + "&renderer=webgl")
        yield chromium, chromium.settle(APPEARS_S), address


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
        (TENSION, HOUSING),
        (FORCE, ESTIMATE),
        (STATE, STATES["engaged"]),
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
