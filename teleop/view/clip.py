"""A clip or a picture of a recording, for slides: drawn by Matplotlib, without a screen."""

import argparse
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from teleop.errors import UsageError
from teleop.messages.topics import COMMAND, HAND, PROFILE, SHEATH, STATE, TENDONS
from teleop.recording.reader import RecordingInfo, read_row_parts
from teleop.recording.scan import Scan
from teleop.runtime.output_file import replace_file
from teleop.runtime.process import parse_seconds
from teleop.runtime.status_line import Progress
from teleop.session.state_machine import State
from teleop.view.colours import TENSION_MAP
from teleop.view.columns import AnyTopic, RowDecimator, Rows
from teleop.view.config import ViewConfig
from teleop.view.feed import BatchDisplay, show_recording
from teleop.view.scene_sheaths import Sheaths
from teleop.view.space_arm import SpaceArm

if TYPE_CHECKING:
    from teleop.view.clip_canvas import ClipData, ThemeName
    from teleop.view.clip_figure import ClipFigure

VIDEO_SUFFIX, PICTURE_SUFFIX = ".mp4", ".png"
SUFFIXES = (VIDEO_SUFFIX, ".gif", PICTURE_SUFFIX)
SIZE_MIN, SIZE_MAX = 200, 3840  # [pixels]
FPS_MAX = 60.0
DEFAULT_FPS = {VIDEO_SUFFIX: 30.0, ".gif": 12.5, PICTURE_SUFFIX: 1.0}
CURVES_HZ = 100.0  # of the rows kept for curves: more are not told apart
PALETTE_FRAMES = 6  # of which the colours of a GIF are chosen, and the scale of tension
PALETTE_ROWS = 200  # of pixels of that scale, among them
BLOCK_S = 1.0  # of a recording, read at once
QUALITY = 8.0  # of a video, of 10
TOPICS = (COMMAND, HAND, PROFILE, STATE, TENDONS)


@dataclass(frozen=True, slots=True)
class ClipOptions:
    """What part of a recording is drawn, and how."""

    begin_s: float  # of the recording
    end_s: float | None
    size: tuple[int, int]  # [pixels] width, height
    fps: float | None  # frames a second
    theme: "ThemeName"
    joint: int  # whose curves are drawn, from 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of a clip to `teleop view`."""
    group = parser.add_argument_group("a clip of a recording (--out .mp4, .gif or .png)")
    group.add_argument(
        "--from", dest="begin_s", type=_parse_moment, metavar="S",
        help="begin, in seconds of the recording (default 0)",
    )  # fmt: skip
    group.add_argument(
        "--to", dest="end_s", type=parse_seconds, metavar="S",
        help="end, in seconds of the recording (default its end); of a picture the moment "
        "(default that of the highest tension)",
    )  # fmt: skip
    group.add_argument(
        "--size", type=_parse_size, metavar="WxH",
        help="pixels (default 1280x720); text keeps its share of the height",
    )  # fmt: skip
    group.add_argument(
        "--fps", type=_parse_fps, metavar="N", help="frames a second (default 30, of a GIF 12.5)"
    )
    group.add_argument("--theme", choices=("light", "dark"), help="background (default light)")
    group.add_argument("--joint", type=int, metavar="N", help="whose curves are drawn (default 1)")


def get_options(args: argparse.Namespace) -> ClipOptions:
    """Return the options of a clip that a command line has; `UsageError` if they conflict."""
    options = ClipOptions(
        begin_s=args.begin_s or 0.0,
        end_s=args.end_s,
        size=args.size or (1280, 720),
        fps=args.fps,
        theme=args.theme or "light",
        joint=1 if args.joint is None else args.joint,
    )
    if options.end_s is not None and options.end_s <= options.begin_s:
        raise UsageError(f"--to {options.end_s:g}: must be after --from {options.begin_s:g}")
    return options


def refuse_options(args: argparse.Namespace) -> None:
    """Raise `UsageError` for an option of a clip where none is drawn."""
    names = {"begin_s": "from", "end_s": "to"}
    for name in ("begin_s", "end_s", "size", "fps", "theme", "joint"):
        if getattr(args, name) is not None:
            raise UsageError(
                f"--{names.get(name, name)}: is of a clip of a recording; name it by --out, as in "
                "teleop view RECORDING.mcap --out clip.mp4"
            )


def write_clip(
    out: Path,
    info: RecordingInfo,
    config: ViewConfig,
    options: ClipOptions,
    arms: Sequence[SpaceArm] = (),
) -> str:
    """Draw a recording into a file by its suffix; returns what was written, as text.

    Raises `UsageError` if there is nothing to draw, or a package is missing.
    """
    suffix = out.suffix.lower()
    if suffix == VIDEO_SUFFIX:
        _import_video_writer()  # before the work
    progress = Progress()
    try:
        length_s = (info.last_ns - info.first_ns) * 1e-9
        begin_s, end_s = options.begin_s, min(options.end_s or math.inf, length_s)
        if begin_s >= end_s:
            raise UsageError(f"--from {begin_s:g}: {info.path} is {length_s:.2f} s long")
        if suffix == PICTURE_SUFFIX:  # of one moment: what came before is not kept
            if options.end_s is None:
                end_s = _find_peak(info, begin_s, end_s, progress)
            begin_s = end_s
        data = _read_data(info, config, options.joint, begin_s, end_s, progress, arms)
        from teleop.view.clip_figure import ClipFigure

        figure = ClipFigure(data, config.layout, options.theme, options.size, options.joint - 1)
        if suffix == PICTURE_SUFFIX:
            with replace_file(out) as partial:
                _to_image(figure.draw(end_s)).save(partial, format="png")
            return f"{out}: {end_s:.2f} s"
        fps = options.fps or DEFAULT_FPS[suffix]
        if suffix == ".gif":  # its times are whole hundredths of a second
            fps = 100.0 / max(2, round(100.0 / fps))
        count = max(1, math.floor((end_s - begin_s) * fps))
        moments = begin_s + np.arange(count) / fps
        frames = _draw_frames(figure, moments, progress)
        with replace_file(out) as partial:
            if suffix == VIDEO_SUFFIX:
                _write_video(partial, frames, fps)
            else:
                _write_gif(partial, frames, fps, _build_palette(figure, moments))
    finally:
        progress.end()
    return f"{out}: {count} frames, {count / fps:.1f} s"


# --- what is drawn


class _Collector(BatchDisplay):
    """Keeps what a clip needs of a recording, and says when no more of it comes."""

    def __init__(self, sheaths: Sheaths, begin_ns: int, end_ns: int) -> None:
        self._sheaths, self._begin_ns, self._end_ns = sheaths, begin_ns, end_ns
        self._decimators = {t: RowDecimator(CURVES_HZ) for t in TOPICS if t is not PROFILE}
        self._parts: dict[AnyTopic, list[Rows]] = {topic: [] for topic in TOPICS}
        self.newest_ns = 0  # stamp of what was read
        self._oldest_ns = 0  # of the last block

    def draw_pictures(self, batches: Mapping[AnyTopic, Rows]) -> int:
        """Keep the rows in time."""
        if SHEATH in batches:
            self._sheaths.learn(batches[SHEATH])
        present = {topic: batches[topic] for topic in TOPICS if topic in batches}
        if present:
            stamps = np.concatenate([rows["stamp_ns"] for rows in present.values()])
            self._oldest_ns, self.newest_ns = int(stamps.min()), int(stamps.max())
        for topic, batch in present.items():
            stamps = batch["stamp_ns"]
            rows = batch[(stamps >= self._begin_ns) & (stamps <= self._end_ns)]
            decimate = self._decimators.get(topic)
            self._parts[topic].append(rows.copy() if decimate is None else decimate(rows))
        return 0

    def is_complete(self) -> bool:
        """Return whether the last block was all after the end, and the sheaths are known."""
        return self._oldest_ns >= self._end_ns and bool(self._sheaths.joints)

    def sort_rows(self) -> dict[AnyTopic, Rows]:
        """Return what was kept, by stamp."""
        kept = {topic: np.concatenate(parts) for topic, parts in self._parts.items() if parts}
        return {t: rows[np.argsort(rows["stamp_ns"], kind="stable")] for t, rows in kept.items()}


def _read_data(
    info: RecordingInfo,
    config: ViewConfig,
    joint: int,
    begin_s: float,
    end_s: float,
    progress: Progress,
    arms: Sequence[SpaceArm] = (),
) -> "ClipData":
    """Return what is drawn of the moments from `begin_s` to `end_s` [s of the recording]."""
    from teleop.view.clip_canvas import ClipData

    begin_ns, end_ns = (info.first_ns + round(s * 1e9) for s in (begin_s - config.window_s, end_s))
    sheaths = Sheaths(config, arms)
    kept = _Collector(sheaths, begin_ns, end_ns)
    length_ns = max(end_ns - info.first_ns, 1)

    def show_progress() -> None:
        progress("reading the recording", min(1.0, (kept.newest_ns - info.first_ns) / length_ns))

    show_recording(str(info.path), kept, kept.is_complete, BLOCK_S, show_progress)
    data = ClipData(config, sheaths, kept.sort_rows(), info.first_ns)
    if not sheaths.joints or STATE not in data.rows or not len(data.rows[STATE]):
        raise UsageError(f"{info.path}: has no sheaths or states to draw between these moments")
    if joint - 1 not in sheaths.joints:
        allowed = ", ".join(str(joint + 1) for joint in sheaths.joints)
        raise UsageError(f"--joint {joint}: there is none; it has {allowed}")
    return data


def _find_peak(info: RecordingInfo, begin_s: float, end_s: float, progress: Progress) -> float:
    """Return the moment of the highest tension along the sheaths, while engaged if ever."""
    fields = {PROFILE.name: ("stamp_ns", "tension"), STATE.name: ("stamp_ns", "state")}
    times: list[NDArray[np.int64]] = []
    tensions: list[NDArray[np.float64]] = []  # highest along the sheath
    changes: list[Rows] = []  # of the state
    for part in read_row_parts(Scan(info.path), fields):
        if PROFILE.name in part:
            rows = part[PROFILE.name].rows
            times.append(rows["stamp_ns"].copy())
            tensions.append(rows["tension"].max(axis=1))
            share = (int(rows["stamp_ns"][-1]) - info.first_ns) * 1e-9 / end_s
            progress("finding the highest tension", min(max(share, 0.0), 1.0))
        if STATE.name in part:
            rows = part[STATE.name].rows
            changes.append(rows[np.diff(rows["state"], prepend=-1) != 0])
    if not times:
        return end_s
    stamps_ns, rank = np.concatenate(times), np.concatenate(tensions)
    seconds = (stamps_ns - info.first_ns) * 1e-9
    rank[(seconds < begin_s) | (seconds > end_s)] = -math.inf
    if changes:
        states = np.concatenate(changes)
        at = np.searchsorted(states["stamp_ns"], stamps_ns, side="right") - 1
        engaged = (states["state"][np.maximum(at, 0)] == State.ENGAGED) & np.isfinite(rank)
        if engaged.any():
            rank[~engaged] = -math.inf
    return float(seconds[rank.argmax()]) if np.isfinite(rank).any() else end_s


# --- files


def _draw_frames(
    figure: "ClipFigure", moments: NDArray[np.float64], progress: Progress
) -> Iterator[NDArray[np.uint8]]:
    for number, moment in enumerate(moments):
        progress("drawing the frames", number / len(moments))
        yield figure.draw(float(moment))


def _import_video_writer() -> Any:
    try:
        import imageio_ffmpeg
    except ModuleNotFoundError as error:
        raise UsageError(
            "--out: a video needs the Python package imageio-ffmpeg: pip install "
            "'tendon-teleop[clip]'; a .gif needs none"
        ) from error
    return imageio_ffmpeg


def _write_video(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> None:
    first = next(frames)
    tall, wide, _ = first.shape
    writer = _import_video_writer().write_frames(
        str(path), (wide, tall), fps=fps, quality=QUALITY, macro_block_size=2,
        ffmpeg_log_level="error", output_params=["-f", "mp4", "-movflags", "+faststart"],
    )  # fmt: skip
    writer.send(None)
    try:
        for frame in itertools.chain([first], frames):
            writer.send(frame.tobytes())
    finally:
        writer.close()


def _build_palette(figure: "ClipFigure", moments: NDArray[np.float64]) -> Any:
    """Return an image with the colours of a clip: of some frames, and the scale of tension."""
    from PIL import Image

    chosen = moments[np.linspace(0, len(moments) - 1, PALETTE_FRAMES).astype(int)]
    sample = [figure.draw(float(moment)) for moment in chosen]
    width = sample[0].shape[1]
    places = np.linspace(0.0, len(TENSION_MAP) - 1.0, width)
    scale = [np.interp(places, np.arange(len(TENSION_MAP)), TENSION_MAP[:, k]) for k in range(3)]
    sample.append(np.tile(np.stack(scale, axis=1).astype(np.uint8), (PALETTE_ROWS, 1, 1)))
    return _to_image(np.concatenate(sample)).quantize(method=Image.Quantize.MAXCOVERAGE)


def _write_gif(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float, palette: Any) -> None:
    """Write an animation with one palette, so that no colour flickers."""
    from PIL import Image

    palette_frames = (
        _to_image(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames
    )
    next(palette_frames).save(
        path,
        format="gif",
        save_all=True,
        append_images=palette_frames,
        duration=1000.0 / fps,
        loop=0,
    )


def _to_image(frame: NDArray[np.uint8]) -> Any:
    from PIL import Image

    return Image.fromarray(frame)


# --- options


def _parse_moment(text: str) -> float:
    return 0.0 if text.strip("0.") == "" and text else parse_seconds(text)


def _parse_size(text: str) -> tuple[int, int]:
    wide, _, tall = text.partition("x")
    if not (wide.isdecimal() and tall.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT, as 1280x720")
    size = int(wide), int(tall)
    if any(not SIZE_MIN <= part <= SIZE_MAX or part % 2 for part in size):
        raise argparse.ArgumentTypeError(
            f"{text!r}: both must be even numbers, {SIZE_MIN} to {SIZE_MAX}"
        )
    return size


def _parse_fps(text: str) -> float:
    value = parse_seconds(text)
    if value > FPS_MAX:
        raise argparse.ArgumentTypeError(f"{text!r}: at most {FPS_MAX:g}")
    return value
