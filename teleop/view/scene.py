"""Convert rows of messages to Rerun columns in batches.

Entities, all on the timeline `time` (the stamp its sender gave a message):

======================================= ========================================================
scene/tendon_<i>/tube                   a sheath coloured by tension, and X' on it
scene/joint_<j>, scene/hand_<j>         tip and hand with the forces on them
scene/arm_<i>                           an arm in space, its tendons, the force at its tip, its hand
scene/legend                            the colour scale
profile/tendon_<i>/curve, band          T(x) with X', and what is certain of it, as a plot
profile/tendon_<i>/tension              T(x) [N] itself: component `tension`, 65 numbers of 64 bits
loop/tendon_<i>/curve                   T_out over T_in
tension, displacement, elongation,      curves over time, see `teleop.view.curves`
force, tip_force, position, hand,
energy, rate, latency, age, loss
state/<role>, log                       lanes of states, the text log
panel/banner, words, joint_<j>, link    state, force and link in large letters
======================================= ========================================================
"""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
import rerun as rr

from teleop.messages.messages import PHASE_NAMES, STOP_ACTIONS, decode_text
from teleop.messages.topics import (
    ANSWER,
    EVENT,
    HAND,
    PROFILE,
    SETTING,
    SHEATH,
    STATE,
    STOP,
    TENDONS,
    Role,
    format_role,
)
from teleop.session.state_machine import State
from teleop.view.colours import LABEL, PHASES, STATES, to_rgba
from teleop.view.columns import AnyTopic, Rows, Sender, Subsampler, build_columns, split_rows
from teleop.view.config import ViewConfig
from teleop.view.curves import Plots
from teleop.view.feed import BatchDisplay
from teleop.view.panel import Panel
from teleop.view.profile_plot import Plane, ProfileView, compute_axis_end, compute_ticks_to_end
from teleop.view.scene_arms import Arms
from teleop.view.scene_geometry import Stage
from teleop.view.scene_joints import Levers
from teleop.view.scene_sheaths import Sheaths, Tubes
from teleop.view.space_arm import SpaceArm

# --- fit the scene into its view, with the colour scale beside it

_STEPS = 65
_HALF_WIDTH = 0.035  # of its height
_TITLE_HEIGHT = 1.2  # likewise


def draw_stage(sender: Sender, stage: Stage, top: float) -> None:
    """Fit the scene into the view, with the colours from 0 to `top` [N] and round values beside."""
    scale, foot, up = 1.0 / stage.span, stage.legend, stage.legend_up
    fit = rr.Transform3D(translation=-scale * stage.centre, scale=scale)
    sender.send_static("scene", fit)
    tall = float(np.linalg.norm(up))
    levels = np.linspace(0.0, 1.0, _STEPS)
    half = np.array([_HALF_WIDTH * tall, 0.0, 0.0])
    edge = foot + levels[:, None] * up
    left = np.arange(_STEPS - 1)
    right = left + _STEPS
    bar = rr.Mesh3D(  # without normals it is not shaded, so colours are exact
        vertex_positions=np.concatenate([edge - half, edge + half]),
        triangle_indices=np.concatenate(
            [np.stack([left, right, right + 1], 1), np.stack([left, right + 1, left + 1], 1)]
        ),
        vertex_colors=np.tile(to_rgba(levels * top, top), 2),
    )
    sender.send_static("scene/legend/scale", bar)
    offset = np.array([0.13 * tall, 0.0, 0.0])
    marks = compute_ticks_to_end(top)
    places = [foot + value / top * up + offset for value in marks]
    values = [f"{value:g}" for value in marks]
    sender.send_words("scene/legend/values", rr.Points3D, places, values, LABEL)
    title = [foot + _TITLE_HEIGHT * up]
    sender.send_words("scene/legend/title", rr.Points3D, title, "tension [N]", 0xFFFFFFFF)


# --- events as a text log, and the sides' states as coloured lanes over time

LOGGED_TOPICS: tuple[AnyTopic, ...] = (EVENT, STOP, SETTING, ANSWER)
_REPEAT_NS = 10_000_000_000  # [ns] a state is repeated, for views of the recent past
_LEVELS = {"fault": "ERROR", "stopped": "CRITICAL", "holding": "WARN"}


def log_rows(sender: Sender, topic: AnyTopic, rows: Rows) -> None:
    """Send text messages."""
    texts = [_format_message(topic, row) for row in rows]
    columns = rr.TextLog.columns(
        text=[
            f"{format_time_of_day(row)}  {text}" for row, (text, _) in zip(rows, texts, strict=True)
        ],
        level=[level for _, level in texts],
    )
    sender.send_columns("log", rows, columns)


def format_time_of_day(row: np.void) -> str:
    """Return the time of day at which a message was sent, UTC."""
    moment = np.datetime64(int(row["stamp_ns"]), "ns").astype("datetime64[ms]")
    return str(moment).split("T")[1]


def _format_message(topic: AnyTopic, row: np.void) -> tuple[str, str]:
    """Return the line of one message, and its level."""
    if topic is STOP:
        action = int(row["action"])
        word = STOP_ACTIONS[action] if action < len(STOP_ACTIONS) else f"action {action}"
        level = "CRITICAL" if word == "stop" else "INFO"
        return f"{format_role(int(row['role']))}: {word}: {decode_text(tuple(row['text']))}", level
    if topic is SETTING:
        return f"set {decode_text(tuple(row['key']))} = {decode_text(tuple(row['value']))}", "INFO"
    text = f"{format_role(int(row['role']))}: {decode_text(tuple(row['text']))}"
    if topic is ANSWER:
        return text, "INFO" if row["accepted"] else "WARN"
    return text, _LEVELS.get(format_state(int(row["state"])), "INFO")


def format_state(number: int) -> str:
    """Return the name of a session's state in small letters."""
    return State(number).name.lower()


class StateLanes:
    """Draws the state of each side under `state/<role>`, on changes and periodically."""

    def __init__(self, sender: Sender) -> None:
        self._sender = sender
        self._shown: dict[Role, tuple[int, int]] = {}  # role -> state, stamp [ns] of the last row

    def draw(self, role: Role, rows: Rows) -> None:
        """Draw the states in messages of one side, every one of them."""
        if len(rows) == 0:
            return
        state, said_ns = self._shown.get(role, (-1, 0))
        states = rows["state"].astype(np.int64)
        changed = np.diff(states, prepend=state) != 0
        keep = np.flatnonzero(changed)
        if len(keep) == 0 and int(rows["stamp_ns"][-1]) - said_ns > _REPEAT_NS:
            keep = np.array([len(rows) - 1])
        if len(keep) == 0:
            return
        self._shown[role] = int(states[keep[-1]]), int(rows["stamp_ns"][keep[-1]])
        path = f"state/{format_role(role)}"
        style = rr.StateConfiguration(values=list(STATES), colors=list(STATES.values()))
        self._sender.send_once(path, style)
        names = [format_state(int(number)) for number in states[keep]]
        self._sender.send_columns(path, rows[keep], rr.StateChange.columns(state=names))


# --- the hysteresis loop T_out over T_in as it grows, coloured by the paper's phases

_GAP_NS = 500_000_000  # [ns] without a sample: the loop begins anew


class LoopView:
    """Draws one loop for each tendon, under `loop/tendon_<i>`.

    Each row holds the one piece from the row before: the view shows all rows of its time range, so
    the loop grows and what is old leaves it.
    """

    def __init__(self, config: ViewConfig, sender: Sender) -> None:
        self._sender = sender
        top = compute_axis_end(config.tension_scale_N)
        self._plane = Plane(
            top, top, 1.0, "T_in [N], measured at the housing", "T_out [N], estimated at the tip"
        )
        self._last: Rows | None = None  # the row drawn last

    def draw(self, rows: Rows) -> None:
        """Draw TendonState rows, all tendons in use."""
        if len(rows) == 0:
            return
        if self._last is None:
            self._plane.draw_axes(self._sender, "loop")
            places = [(1.4, -1.0 + 0.16 * k) for k in range(len(PHASES))]
            names, colours = list(PHASE_NAMES), list(PHASES)
            self._sender.send_words("loop/names", rr.Points2D, places, names, colours)
        all_rows = rows if self._last is None else np.concatenate([self._last, rows])
        self._last = rows[-1:]
        before, after = all_rows[:-1], all_rows[1:]
        is_continuous = after["stamp_ns"] - before["stamp_ns"] < _GAP_NS
        palette = np.array(PHASES, np.uint32)
        for tendon in range(int(rows["tendons"][-1])):
            begin, end = (
                self._plane.to_points(
                    part["proximal_tension"][:, tendon], part["distal_tension"][:, tendon]
                )
                for part in (before, after)
            )
            is_shown = is_continuous & np.isfinite(begin).all(axis=1) & np.isfinite(end).all(axis=1)
            if not is_shown.any():
                continue
            strips = np.stack([begin, end], axis=1)[is_shown]
            phase = np.minimum(after["phase"][is_shown, tendon], len(PHASES) - 1)
            radii = np.full(len(strips), 0.006)
            pieces = build_columns(
                rr.LineStrips2D, strips=strips, colors=palette[phase], radii=radii
            )
            path = f"loop/tendon_{tendon}/curve"
            self._sender.send_columns_at(path, after["stamp_ns"][is_shown], pieces)


class Scene(BatchDisplay):
    """Draws decoded batches.

    Keeps only what later messages need: the sheaths, the newest interval at each tip, and static
    data.

    `lay_out` is called with the tendons of each joint when they become known or change. With
    `everything` what the layout does not show is sent too, for a file: it may be opened in another
    layout, or read by Rerun's tools. With `live` curves in tabs that are behind at first grow once
    a second; at the end less than a second of them is missing.
    """

    def __init__(
        self,
        config: ViewConfig,
        stream: rr.RecordingStream,
        lay_out: Callable[[Mapping[int, list[int]]], None] = lambda _: None,
        everything: bool = True,
        live: bool = False,
        arms: Sequence[SpaceArm] = (),
    ) -> None:
        self._config = config
        self._lay_out = lay_out
        self._everything = everything
        self._spatial = everything or config.layout != "surgeon"
        self._plotted = everything or config.layout == "experiment"
        self._sender = Sender(stream)
        self._sheaths = Sheaths(config, arms)
        self._subsample = Subsampler()
        parts = config, self._sender, self._sheaths, self._subsample
        self._tubes, self._levers, self._arms = Tubes(*parts), Levers(*parts), Arms(*parts)
        self._profiles = ProfileView(*parts, values=everything)
        self._loops = LoopView(config, self._sender)
        self._plots = Plots(*parts, live=live)
        self._lanes = StateLanes(self._sender)
        self._panel = Panel(*parts)

    @property
    def newest_ns(self) -> int:
        """The newest stamp that was sent [ns]; 0 before any."""
        return self._sender.newest_ns

    def send(self, batches: Mapping[AnyTopic, Rows]) -> int:
        """Send one batch of each topic, all of it; returns the number of rows that were shown."""
        return self.draw_pictures(batches) + self.draw_curves(batches)

    def draw_pictures(self, batches: Mapping[AnyTopic, Rows]) -> int:
        """Update the scene and the log; returns the number of rows shown."""
        shown = 0
        if SHEATH in batches:
            shown += self._learn(batches[SHEATH])
        if self._plotted:
            shown += self._draw_plots(batches)
        if self._spatial:
            for tendon, rows in self._select_profiles(batches):
                self._tubes.draw(tendon, rows)
                shown += len(rows)
            self._levers.draw(batches)
            self._arms.draw(batches)
        self._panel.draw(batches)
        return shown

    def draw_curves(self, batches: Mapping[AnyTopic, Rows]) -> int:
        """Draw the curves over time and the loops, and send T(x); returns the number of rows shown.

        Both grow, so each block adds to what is there.
        """
        if not self._plotted:
            return 0
        if TENDONS in batches:
            self._loops.draw(self._subsample(batches[TENDONS], self._config.rate_hz.loop))
        for tendon, rows in self._select_profiles(batches) if self._everything else ():
            self._profiles.send_values(tendon, rows)
        return self._plots.draw(batches)

    def _draw_plots(self, batches: Mapping[AnyTopic, Rows]) -> int:
        """Draw T(x), the states and the log; returns the number of log lines."""
        shown = 0
        if TENDONS in batches:
            self._profiles.add(batches[TENDONS])
        for tendon, rows in self._select_profiles(batches):
            self._profiles.draw(tendon, rows)
        for role, topic in ((Role.MASTER, HAND), (Role.SLAVE, STATE)):
            if topic in batches:
                self._lanes.draw(role, batches[topic])
        for topic in LOGGED_TOPICS:
            if topic in batches:
                log_rows(self._sender, topic, batches[topic])
                shown += len(batches[topic])
        return shown

    def _select_profiles(self, batches: Mapping[AnyTopic, Rows]) -> Iterator[tuple[int, Rows]]:
        """Yield each tendon with its tension profiles, at the rate of the display."""
        for tendon, rows in (
            split_rows(batches[PROFILE], "tendon").items() if PROFILE in batches else ()
        ):
            yield tendon, self._subsample(rows, self._config.rate_hz.profile)

    def stretch(self, factor: float) -> None:
        """Draw fewer rows, by this factor, where the periods of drawing are stretched by it."""
        self._subsample.stretch = factor

    def show_silence(self, silent_ns: int) -> None:
        """Show that nothing has arrived for so long [ns]."""
        self._panel.show_silence(silent_ns)
        self._forget_forces(silent_ns)

    def show_end(self, what: str, silent_ns: int = 0) -> None:
        """Show that a session or recording ended so long [ns] after its last data, no forces."""
        self._panel.show_end(what, silent_ns)
        self._forget_forces(silent_ns)

    def _forget_forces(self, silent_ns: int) -> None:
        present_ns = self._panel.compute_present_ns(silent_ns)
        self._levers.forget_forces(present_ns)
        self._arms.forget_forces(present_ns)

    def show_panel(self) -> None:
        """Send all of the panel from now on, which `surgeon` shows; from any thread."""
        self._panel.whole = True

    def _learn(self, rows: Rows) -> int:
        """Process the sheaths, and redraw everything if they have changed."""
        if not self._sheaths.learn(rows):
            return 0
        self._sender.forget_styles()
        if self._spatial:
            for part in (self._tubes, self._levers, self._arms):
                part.place()
            if self._sheaths.stage is not None:
                draw_stage(self._sender, self._sheaths.stage, self._config.tension_scale_N)
        joints = {joint: self._sheaths.list_tendons(joint) for joint in self._sheaths.joints}
        self._lay_out(joints)
        return len(joints)
