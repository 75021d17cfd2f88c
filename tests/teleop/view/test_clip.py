"""Clips and pictures of a recording: what is drawn is what was recorded, in files that open."""

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from teleop.cli import commands
from teleop.messages.topics import PROFILE, STATE
from teleop.recording.reader import open_recording
from teleop.runtime.status_line import Progress
from teleop.view import clip, colours
from teleop.view.clip_canvas import THEMES
from teleop.view.clip_figure import ClipFigure
from teleop.view.colours import to_rgb
from tests.teleop.recorded import record
from tests.teleop.view.made_session import CONFIG, T0

SIZE = (640, 360)


@pytest.fixture(scope="module")
def recording(session, tmp_path_factory):
    """A recording of one second, with the scale of tension of `CONFIG`."""
    config = "view: {tension_scale_N: 10}\n"
    return record(tmp_path_factory.mktemp("clip"), session.unpack(), config)


@pytest.fixture(scope="module")
def drawn(recording):
    """The data of a clip of the whole recording."""
    info = open_recording(recording)
    return clip._read_data(info, CONFIG, 1, 0.0, info.seconds, Progress())


def view(*words):
    return commands.main(["view", *map(str, words)])


def has_colour(frame, colour, tolerance=6):
    """Whether some pixels have a colour, 0xRRGGBBAA or three shares."""
    rgb = to_rgb(colour) if isinstance(colour, int) else colour
    far = np.abs(frame.astype(int) - np.rint(255 * np.array(rgb)).astype(int)).max(axis=-1)
    return (far <= tolerance).sum() > 10


@pytest.mark.parametrize(
    ("layout", "theme"), [("experiment", "light"), ("presentation", "dark"), ("surgeon", "light")]
)
def test_every_layout_shows_the_state_and_the_force_on_its_background(drawn, layout, theme):
    figure = ClipFigure(drawn, layout, theme, SIZE, 0)
    for moment, state in ((0.2, "ready"), (0.9, "engaged")):
        frame = figure.draw(moment)
        assert frame.shape == (SIZE[1], SIZE[0], 3)
        assert has_colour(frame, colours.STATES[state])
        assert has_colour(frame, THEMES[theme].background, 0)
        assert has_colour(frame, THEMES[theme].adapt(colours.ESTIMATE))


def test_a_frame_does_not_depend_on_those_before_it(drawn):
    figure = ClipFigure(drawn, "experiment", "light", SIZE, 0)
    first = figure.draw(0.7)
    figure.draw(0.2)
    assert (figure.draw(0.7) == first).all()


def test_the_sheath_has_the_colours_of_its_tension(session, drawn):
    frame = ClipFigure(drawn, "presentation", "dark", (1280, 720), 0).draw(0.8)
    sheath = frame[:, : int(0.85 * frame.shape[1])]  # the scale, at the right, has all colours
    newest = [m for m in session.of(PROFILE) if m.tendon == 0 and m.stamp_ns <= T0 + 8e8][-1]
    for place in (5, 32, 60):
        tension = np.array([newest.tension[place]])
        assert has_colour(sheath, int(colours.to_rgba(tension, CONFIG.tension_scale_N)[0]), 3)
    never = colours.to_rgba(np.array([CONFIG.tension_scale_N * 0.15]), CONFIG.tension_scale_N)
    assert not has_colour(sheath, int(never[0]), 2)


def test_curves_end_at_the_newest_values(session, drawn):
    figure = ClipFigure(drawn, "experiment", "light", SIZE, 0)
    figure.draw(0.6)
    panels = {axes.get_title(loc="left"): axes for axes in figure.figure.axes}
    newest = [m for m in session.of(STATE) if m.stamp_ns <= T0 + 6e8][-1]
    ends = {}
    for title in ("Force at the tip [N]", "Tip [mm]"):
        for line in panels[title].lines:
            x, y = line.get_data()
            assert abs(x[-1]) < 0.011
            ends.setdefault(title, []).append(y[-1])
    assert any(abs(end - newest.force[0]) < 0.11 for end in ends["Force at the tip [N]"])
    assert any(abs(end - 1e3 * newest.position[0]) < 0.11 for end in ends["Tip [mm]"])
    (area,) = panels["Force at the tip [N]"].collections
    corners = area.get_paths()[0].vertices
    at = corners[:, 0] == corners[:, 0].max()
    assert corners[at, 1].min() == pytest.approx(newest.force_low[0], abs=0.11)
    assert corners[at, 1].max() == pytest.approx(newest.force_high[0], abs=0.11)


def test_a_picture_is_of_the_moment_that_is_asked_for(recording, tmp_path, capsys):
    out = tmp_path / "moment.png"
    assert view(recording, "--out", out, "--to", 0.3, "--size", "640x360") == 0
    assert capsys.readouterr().out == f"wrote {out}: 0.30 s\n"
    with Image.open(out) as picture:
        assert picture.size == SIZE
        frame = np.asarray(picture.convert("RGB"))
    assert has_colour(frame, colours.STATES["ready"])
    assert view(recording, "--out", tmp_path / "peak.png", "--size", "640x360") == 0
    with Image.open(tmp_path / "peak.png") as picture:  # of the highest tension while engaged
        assert has_colour(np.asarray(picture.convert("RGB")), colours.STATES["engaged"])


def test_an_animation_has_its_frames_and_its_time(recording, tmp_path):
    out = tmp_path / "clip.gif"
    words = ("--from", 0.2, "--to", 0.8, "--fps", 5, "--size", "480x270", "--theme", "dark")
    assert view(recording, "--out", out, *words) == 0
    with Image.open(out) as animation:
        assert (animation.n_frames, animation.size) == (3, (480, 270))
        assert animation.info["duration"] == 200
        frames = []
        for number in range(animation.n_frames):
            animation.seek(number)
            frames.append(np.asarray(animation.convert("RGB")))
    assert has_colour(frames[0], colours.STATES["ready"], 12)
    assert has_colour(frames[-1], colours.STATES["engaged"], 12)
    assert view(recording, "--out", out, *words) == 2  # exists


def test_a_video_has_its_frames_and_its_time(recording, tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra `clip`")
    out = tmp_path / "clip.mp4"
    words = ("--from", 0.2, "--to", 0.8, "--fps", 10, "--size", "480x270")
    assert view(recording, "--out", out, *words) == 0
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(out))
    assert (frames, round(seconds, 2)) == (6, 0.6)
    assert [path.name for path in tmp_path.iterdir()] == ["clip.mp4"]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--out", "x.gif"), "is drawn from a recording"),
        (("FILE", "--out", "x.gif", "--from", "3"), "s long"),
        (("FILE", "--out", "x.gif", "--from", "0.5", "--to", "0.4"), "must be after --from"),
        (("FILE", "--out", "x.gif", "--size", "641x360"), "even numbers"),
        (("FILE", "--out", "x.gif", "--fps", "1000"), "at most 60"),
        (("FILE", "--out", "x.gif", "--joint", "2"), "it has 1"),
        (("FILE", "--out", "x.gif", "--view", "web"), "leave out --view"),
        (("FILE", "--out", "x.rrd", "--theme", "dark"), "--theme: is of a clip"),
        (("--from", "3"), "--from: is of a clip"),
        (("FILE", "--out", "x.avi"), "must end in one of .rrd, .mp4, .gif, .png"),
        (("FILE", "--out", "x.mp4"), "pip install 'tendon-teleop[clip]'"),
    ],
)
def test_what_cannot_be_drawn_is_one_line(
    recording, words, complaint, tmp_path, monkeypatch, refused
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # as if it were not installed
    assert complaint in refused("view", *(recording if word == "FILE" else word for word in words))
    assert not list(Path().iterdir())
