"""The pictures of the live view, made from real runs: `make pictures`.

Each run is recorded, fed to the viewer up to a chosen moment, and its web page photographed in a
headless Chromium (drawn by software: a minute or two a picture). The animation is drawn from the
same recording. Without a Chromium only the animation is made.
"""

import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from PIL import Image

from studies.testbed import browser
from studies.testbed.processes import find_free_ports
from teleop.cli import commands
from teleop.config import loading
from teleop.messages.messages import PROFILE_POINTS
from teleop.messages.topics import PROFILE, SHEATH, STATE, TENDONS, TOPICS
from teleop.recording.reader import read_messages
from teleop.session.state_machine import State
from teleop.view.colours import TENSION_MAP
from teleop.view.columns import AnyTopic, Rows, decode
from teleop.view.config import Layout, ViewConfig
from teleop.view.feed import show_recording
from teleop.view.scene import Scene
from teleop.view.scene_geometry import RIGHT, UP
from teleop.view.scene_sheaths import Sheaths, compute_tension_band
from teleop.view.sinks import Sink

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
SETTLED_S = 300.0  # [s] a page has to appear in
STILL = 6  # looks at a page that must be the same: data arrive in bursts on a busy machine
SLOWED = 4  # times slower than it was
FRAMES_HZ = 15
AROUND_S = (-0.35, 0.6)  # [s] from the moment, in the animation
COLOURS = 128  # in its palette
CMAP = mpl.colors.LinearSegmentedColormap.from_list("tension", TENSION_MAP / 255)
DARK, RED, BLUE, ORANGE = "#121418", "#ff4b4b", "#56b4e9", "#e69f00"
WORDS = (
    ("thick: slides", "white"),
    ("thin: friction still holds", "white"),
    ("X', the front", RED),
)


class Shot(NamedTuple):
    """A picture to be made."""

    file: str
    config: str  # in configs/
    layout: Layout
    past_s: float  # [s] shown of what comes often


SHOTS = (
    Shot("view.png", "demo", "experiment", 10.0),
    Shot("view-surgeon.png", "demo", "surgeon", 10.0),
    Shot("view-arm.png", "arm", "presentation", 0.5),
)


class Recorded(NamedTuple):
    """A recorded run."""

    path: Path
    view: ViewConfig
    rows: Mapping[AnyTopic, Rows]


def main() -> int:
    """Make all pictures; returns the exit code."""
    with tempfile.TemporaryDirectory(prefix="pictures-") as folder:
        runs = {name: recorded(name, Path(folder)) for name in ("demo", "arm")}
        animate(runs["demo"], IMAGES / "front.gif")
        if browser.find_program() is None:
            print("no Chromium here: only the animation was made", file=sys.stderr)
            return 1
        for shot in SHOTS:
            run = runs[shot.config]
            photograph(run, shot, turn_of(run), IMAGES / shot.file)
    return 0


def recorded(name: str, folder: Path) -> Recorded:
    """Run a session for some seconds, and record it."""
    file = ROOT / "configs" / f"{name}.yaml"
    where = folder / name
    master, slave = find_free_ports(2)
    own = (f"session={name}-picture", *(f"link.{side}=127.0.0.1:{port}"
           for side, port in (("master", master), ("slave", slave))))  # fmt: skip
    words = [word for text in own for word in ("--set", text)]
    words += ["--config", str(file), "--duration", "16", "--view", "none", "--record", str(where)]
    code = commands.main(["run", *words])
    if code:
        raise SystemExit(code)
    (path,) = where.glob("*.mcap")
    by_name = {topic.name: topic for topic in TOPICS}
    messages = [(by_name[m.topic], m.data) for m in read_messages(str(path), by_name.keys())]
    return Recorded(path, loading.load(file, ViewConfig, "view"), decode(messages))


def turn_of(run: Recorded) -> float:
    """Return a moment [s since the epoch] at which a front is half-way and the tension high."""
    rows, states = run.rows[PROFILE], run.rows[STATE]
    share = rows["front"] / rows["length"]
    highest = rows["tension"].max(axis=1)
    engaged = states["state"][_newest(states, rows["stamp_ns"] * 1e-9)] == State.ENGAGED
    fits = engaged & (share > 0.35) & (share < 0.65) & (highest < 1.05 * run.view.tension_scale_N)
    if not fits.any():
        raise SystemExit(f"{run.path}: no front was half-way while engaged; is the machine busy?")
    return float(rows["stamp_ns"][np.where(fits, highest, -1.0).argmax()]) * 1e-9


def photograph(run: Recorded, shot: Shot, until_s: float, path: Path) -> None:
    """Show a run up to a moment on the web page, and save the page."""
    settings = replace(run.view, layout=shot.layout)
    with Sink("web", settings, "demo", None, live=False) as sink, browser.Browser() as page:
        if sink.stream is None:
            raise RuntimeError("a web view has a stream")
        scene = Scene(settings, sink.stream, sink.lay_out)
        show_recording(
            str(run.path), _Between(scene, until_s, shot.past_s), _never, 0.25, sink.publish
        )
        page.open(sink.lines[0].removeprefix("Web view: ") + "?renderer=webgl&layout=full")
        page.settle(SETTLED_S, still=STILL)
        page.save(path)
    print(path.relative_to(ROOT))


def _never() -> bool:
    return False


class _Between:
    """A scene that is shown only some seconds up to a moment, and all that comes seldom."""

    def __init__(self, scene: Scene, until_s: float, past_s: float) -> None:
        self._scene = scene
        self._end_ns = round(until_s * 1e9)
        self._begin_ns = self._end_ns - round(past_s * 1e9)

    def _cut(self, batches: Mapping[AnyTopic, Rows]) -> dict[AnyTopic, Rows]:
        cut = {}
        for topic, rows in batches.items():
            begin_ns = self._begin_ns if topic.live else 0
            inside = (rows["stamp_ns"] >= begin_ns) & (rows["stamp_ns"] <= self._end_ns)
            cut[topic] = rows[inside]
        return {topic: rows for topic, rows in cut.items() if len(rows)}

    def draw_pictures(self, batches: Mapping[AnyTopic, Rows]) -> int:
        return self._scene.draw_pictures(self._cut(batches))

    def draw_curves(self, batches: Mapping[AnyTopic, Rows]) -> int:
        return self._scene.curves(self._cut(batches))

    def show_end(self, what: str, silent_ns: int = 0) -> None:
        """Show no end: a moment of the run is photographed."""


def animate(run: Recorded, path: Path) -> None:
    """Draw the tension front on its way along the first tendon, slowed down."""
    sheaths = Sheaths(run.view)
    sheaths.learn(run.rows[SHEATH])
    rows = run.rows[PROFILE][run.rows[PROFILE]["tendon"] == 0]
    begin, end = (turn_of(run) + offset for offset in AROUND_S)
    moments = np.arange(begin, end, 1 / (FRAMES_HZ * SLOWED))
    chosen = rows[_newest(rows, moments)]
    tips = run.rows[TENDONS]
    tips = tips[_newest(tips, moments)]
    low, high = compute_tension_band(
        sheaths.friction[0],
        chosen["tension"][:, 0],
        tips["distal_tension_low"][:, 0],
        tips["distal_tension_high"][:, 0],
    )
    if sheaths.stage is None:
        raise RuntimeError("the recording has no sheath")
    line = sheaths.stage.lines[0] - sheaths.stage.lines[0][0]
    film = Film(run.view.tension_scale_N, line @ np.array([RIGHT, UP]).T, chosen["length"][0])
    frames = [
        film.frame(
            moments[k] - begin, chosen[k], low[k], high[k], tips["bench_distal_tension"][k, 0]
        )
        for k in range(len(moments))
    ]
    _save(frames, path)
    print(path.relative_to(ROOT))


def _save(frames: Sequence[Image.Image], path: Path) -> None:
    """Write an animation with one palette, so that no colour flickers."""
    sample = np.concatenate([np.asarray(frame) for frame in frames[::6]])
    palette = Image.fromarray(sample).quantize(COLOURS)
    plain = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    pause = round(1000 / FRAMES_HZ)
    plain[0].save(path, save_all=True, append_images=plain[1:], duration=pause, loop=0)


def _newest(rows: Rows, moments: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the place of the newest row at each moment [s since the epoch]."""
    at = np.searchsorted(rows["stamp_ns"], (moments * 1e9).astype(np.int64), side="right") - 1
    return np.clip(at, 0, None)


class Film:
    """The sheath as seen in the scene, and T(x) below it."""

    def __init__(self, top: float, line: NDArray[np.float64], length: float) -> None:
        mpl.use("Agg")
        plt.style.use("dark_background")
        self._line, self._length = line, float(length)
        self._x = np.linspace(0.0, self._length, PROFILE_POINTS)
        self._figure = plt.figure(figsize=(7.2, 5.0), facecolor=DARK)
        above = self._figure.add_axes((0.26, 0.42, 0.60, 0.55))
        scale = self._figure.add_axes((0.89, 0.46, 0.02, 0.46))
        below = self._figure.add_axes((0.08, 0.10, 0.89, 0.25), facecolor=DARK)
        step = (len(line) - 1) // (PROFILE_POINTS - 1)
        pieces = [line[k * step : (k + 1) * step + 1] for k in range(PROFILE_POINTS - 1)]
        self._tube = LineCollection(pieces, cmap=CMAP, norm=mpl.colors.Normalize(0, top))
        self._tube.set_capstyle("round")
        above.add_collection(self._tube)
        (self._ball,) = above.plot([], [], "o", color=RED, markersize=12, zorder=3)
        above.set_aspect("equal")
        above.margins(0.06)
        above.autoscale_view()
        above.axis("off")
        self._clock = self._figure.text(0.03, 0.93, "")
        for k, (words, colour) in enumerate(WORDS):
            self._figure.text(0.03, 0.86 - 0.05 * k, words, color=colour)
        self._figure.colorbar(self._tube, scale, label="tension [N]")
        self._band = below.add_patch(Polygon([(0, 0)], color="#1d4a60", label="certain"))
        (self._curve,) = below.plot([], [], color=BLUE, linewidth=2, label="T(x), estimated")
        (self._mark,) = below.plot([], [], "o", color=RED, label="X'")
        (self._truth,) = below.plot(
            [], [], "D", color=ORANGE, clip_on=False, label="measured at the tip"
        )
        below.set(xlim=(0, self._length), ylim=(0, 1.1 * top))
        below.set(xlabel="x [m] from the housing", ylabel="T [N]")
        below.spines[["top", "right"]].set_visible(False)
        below.legend(
            loc="lower left", bbox_to_anchor=(0, 0.98), frameon=False, ncols=4, columnspacing=1.5
        )

    def frame(
        self,
        seconds: float,
        row: np.void,
        low: NDArray[np.float64],
        high: NDArray[np.float64],
        truth: float,
    ) -> Image.Image:
        """Return the picture of one moment."""
        tension, front = row["tension"], float(np.nan_to_num(row["front"]))
        self._tube.set_array((tension[1:] + tension[:-1]) / 2)
        middles = (self._x[1:] + self._x[:-1]) / 2
        self._tube.set_linewidth(np.where(middles <= front, 10.0, 4.5).tolist())
        whole = np.linspace(0, self._length, len(self._line))
        self._ball.set_data(*([np.interp(front, whole, self._line[:, i])] for i in range(2)))
        self._curve.set_data(self._x, tension)
        self._mark.set_data([front], [np.interp(front, self._x, tension)])
        self._truth.set_data([self._length], [truth])
        there, back = np.stack([self._x, low], 1), np.stack([self._x, high], 1)[::-1]
        self._band.set_xy(np.concatenate([there, back]))
        self._clock.set_text(f"{seconds:.2f} s, {SLOWED} times slower")
        canvas = FigureCanvasAgg(self._figure)
        canvas.draw()
        return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])


if __name__ == "__main__":
    sys.exit(main())
