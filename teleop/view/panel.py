"""The panel: state, force with its limit and quality of the link, in large letters.

Everything is drawn as line strips on a plane of `PANEL_WIDTH` by `PANEL_HEIGHT` units, y downwards,
under `panel`. It must be read from two metres: a screen of 53 cm has 33 mm a unit, so the state is
45 mm tall and the smallest words 11 mm.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from estimator.array_types import Array
from teleop.messages.topics import COMMAND, HAND, LINK, REPORT, STATE, Role, format_role
from teleop.runtime.clock import now_ns
from teleop.session.state_machine import PEER_REASONS, Reason, State, to_reason
from teleop.view.colours import (
    PLAIN,
    QUALITIES,
    STATES,
    choose_force_colour,
    compute_luminance,
    to_rgb,
)
from teleop.view.columns import AnyTopic, RowDecimator, Rows, build_columns, split_rows
from teleop.view.panel_layout import (
    BANNER,
    LINK_HEIGHT,
    LINK_LEFT,
    LINK_TOP,
    PANEL_WIDTH,
    REASON_HEIGHT,
    REASON_TOP,
    STATE_HEIGHT,
    STATE_TOP,
    STROKE,
    ForceRow,
    build_text_strips,
    compute_force_rows,
    compute_text_width,
    fill_box,
    fit_height,
)
from teleop.view.scene_sheaths import Painter

# --- state of a session as the panel shows it: both sides' states as one, and the link's quality

# the first of these that a side is in is that of the session
_SEVERITY_ORDER = (
    State.STOPPED, State.FAULT, State.HOLDING, State.OFF, State.READY, State.CLUTCHED,
    State.ENGAGED,
)  # fmt: skip
# shown even if the peer sends nothing
_SERIOUS_STATES = {State.STOPPED, State.FAULT, State.HOLDING}
NO_DATA = "no data"
NO_LINK = "none"
_POOR_LOSS, _BAD_LOSS = 0.01, 0.1  # shares of the peer's messages


class Banner(NamedTuple):
    """What the banner says."""

    state: str  # name of a state in small letters, or `NO_DATA`
    reason: str = ""


def build_banner(sides: Mapping[Role, tuple[int, int]]) -> Banner:
    """Return the state of the session from each side's state and reason.

    It is the most severe of the two, so it is engaged only if both are. Of two sides in that state
    the one whose reason is its own is quoted. Its peer has its name: who watches sees both sides.
    """
    states = {role: State(number) for role, (number, _) in sides.items()}
    serious = any(state in _SERIOUS_STATES for state in states.values())
    if set(sides) != {Role.MASTER, Role.SLAVE} and not serious:
        missing = [format_role(role) for role in (Role.MASTER, Role.SLAVE) if role not in sides]
        return Banner("off", f"waiting for the {' and the '.join(missing)}")
    worst = min(states.values(), key=_SEVERITY_ORDER.index)
    reasons = [(role, to_reason(sides[role][1])) for role, now in states.items() if now is worst]
    own = [(role, reason) for role, reason in reasons if reason not in PEER_REASONS]
    role, reason = (own or reasons)[0]
    peer = format_role(Role.SLAVE if role is Role.MASTER else Role.MASTER)
    text = "" if reason is Reason.NONE else reason.text.replace("peer", peer)
    return Banner(worst.name.lower(), text)


class LinkCounts(NamedTuple):
    """Of one side, since its loop began."""

    received: int
    lost: int  # or rejected


class LinkQuality(NamedTuple):
    """Quality of the link over the last reports."""

    word: str  # good, poor, bad or `NO_LINK`
    loss: float  # share of the messages that did not arrive in order, the worse way
    latency_ms: float | None  # median, command to force; None if not known


def compute_link_quality(
    before: Mapping[Role, LinkCounts],
    now: Mapping[Role, LinkCounts],
    latency_ms: float | None,
    no_reception: bool = False,
) -> LinkQuality:
    """Return the quality from two reports of each side; the worse way counts.

    With `no_reception` a side has received nothing at all between its reports.
    """
    shares = [0.0]
    for role, counts in now.items():
        earlier = before.get(role, counts)
        lost, received = counts.lost - earlier.lost, counts.received - earlier.received
        if lost > 0:
            shares.append(lost / (lost + max(received, 0)))
    loss = max(shares)
    if no_reception:
        return LinkQuality(NO_LINK, loss, None)
    word = "good" if loss < _POOR_LOSS else "poor" if loss < _BAD_LOSS else "bad"
    return LinkQuality(word, loss, latency_ms)


_NUMBER_HZ, _BAR_HZ = 4.0, 10.0  # a number that changes more often cannot be read
_REPEAT_NS = 2_000_000_000  # [ns] after which a banner is repeated, for pages opened later
_STALE_NS = 1_000_000_000  # [ns] after which state and force of a side that sends no more are old
_MARGIN = 0.4


class Panel(Painter):
    """Draws the panel."""

    def __init__(self, *parts: Any) -> None:
        super().__init__(*parts)
        self.whole = self._config.layout == "surgeon"  # others show the banner only
        self._sides: dict[Role, tuple[int, int]] = {}
        self._state_ns: dict[Role, int] = {}  # [ns] `newest_ns` when a side sent its state
        self._shown: tuple[Banner | None, int] = (None, 0)  # and its stamp [ns]
        self._counts: dict[Role, LinkCounts] = {}
        self._no_reception: dict[
            Role, bool
        ] = {}  # whether it received nothing between its last reports
        self._force_ns: int | None = None  # [ns] `newest_ns` when a force came; None: none shown
        self._latency_ms: float | None = None
        self._jitter_ms: float | None = None
        self._allowed: dict[Role, str] = {}  # what the link allows, where that is not all
        self._limit_N = math.nan
        self._placed: tuple[list[ForceRow], list[bool]] = ([], [])
        self._bar_rows, self._number_rows = RowDecimator(_BAR_HZ), RowDecimator(_NUMBER_HZ)
        self._framed: tuple[float, list[bool]] | None = None  # limit, and which are two-way
        self.newest_ns = 0

    def draw(self, batches: Mapping[AnyTopic, Rows]) -> None:
        """Draw a batch."""
        for rows in batches.values():
            self.newest_ns = max(self.newest_ns, int(rows["stamp_ns"].max(initial=0)))
        if COMMAND in batches:
            limits = batches[COMMAND]["force_max"]
            limits = limits[np.isfinite(limits) & (limits > 0)]  # the last command has none
            self._limit_N = float(limits[-1]) if len(limits) else self._limit_N
        self._update_banners(batches)
        if not self.whole:
            return
        if STATE in batches and len(batches[STATE]):
            self._draw_forces(batches[STATE])
            self._force_ns = self.newest_ns
        elif self._force_ns is not None and self.newest_ns - self._force_ns > _STALE_NS:
            self._forget_forces(self.newest_ns)
        if LINK in batches and len(batches[LINK]):
            self._update_link_limits(batches[LINK])
        if REPORT in batches and len(batches[REPORT]):
            self._update_link(batches[REPORT])

    def show_silence(self, silent_ns: int) -> None:
        """Say that nothing has arrived for so long [ns]."""
        self._forget(Banner(NO_DATA, "the session sends nothing"), silent_ns)

    def show_end(self, what: str, silent_ns: int) -> None:
        """Say that a session or recording has ended so long [ns] after its last message."""
        self._forget(Banner(f"{what} ended"), silent_ns)

    def compute_present_ns(self, silent_ns: int) -> int:
        """Return the stamp of now [ns], so long after the last message; our clock before any."""
        return self.newest_ns + silent_ns if self.newest_ns else now_ns()

    def _forget(self, now: Banner, silent_ns: int) -> None:
        """Show a banner, and neither forces nor the link's quality."""
        self._sides.clear()
        stamp_ns = self.compute_present_ns(silent_ns)
        self._show(now, stamp_ns)
        if self.whole and self._counts:
            self._counts.clear()
            self._no_reception.clear()
            self._draw_at("panel/link", stamp_ns, [], PLAIN, 0.0)
        if self._force_ns is not None:
            self._forget_forces(stamp_ns)

    def _update_banners(self, batches: Mapping[AnyTopic, Rows]) -> None:
        """Draw the banner at each change of state or reason of a side, in order of time."""
        changes: list[tuple[int, Role, tuple[int, int]]] = []
        for role, topic in ((Role.MASTER, HAND), (Role.SLAVE, STATE)):
            rows = batches.get(topic)
            if rows is None or len(rows) == 0:
                continue
            self._state_ns[role] = self.newest_ns
            both = np.stack([rows["state"], rows["reason"]], axis=1).astype(np.int64)
            first = np.append(True, (both[1:] != both[:-1]).any(axis=1))
            changes += [
                (int(rows["stamp_ns"][k]), role, (int(both[k, 0]), int(both[k, 1])))
                for k in np.flatnonzero(first)
            ]
        for stamp_ns, role, now in sorted(changes):
            self._sides[role] = now
            self._show(build_banner(self._sides), stamp_ns)
        for role in [*self._sides]:
            if self.newest_ns - self._state_ns[role] > _STALE_NS:
                del self._sides[role]
                self._show(build_banner(self._sides), self.newest_ns)

    def _show(self, now: Banner, stamp_ns: int) -> None:
        before, said_ns = self._shown
        if now == before and stamp_ns - said_ns < _REPEAT_NS:
            return
        # the sides' clocks and blocks differ: a later banner must not lie before an earlier one
        stamp_ns = max(stamp_ns, said_ns)
        self._shown = now, stamp_ns
        _, top, _, bottom = BANNER
        background = STATES.get(now.state, STATES["off"])
        ink = 0x000000FF if compute_luminance(to_rgb(background)) > 0.18 else 0xFFFFFFFF
        middle = (top + bottom) / 2
        # one broad line, whose round ends and upper half lie beyond the view's edges
        line = np.array([[-PANEL_WIDTH, top], [2 * PANEL_WIDTH, top]])
        self._draw_at("panel/banner/area", stamp_ns, [line], background, bottom - top)
        state_top = STATE_TOP if now.reason else middle - STATE_HEIGHT / 2
        self._draw_centred("panel/banner/state", stamp_ns, now.state, state_top, STATE_HEIGHT, ink)
        self._draw_centred(
            "panel/banner/reason", stamp_ns, now.reason, REASON_TOP, REASON_HEIGHT, ink
        )

    def _draw_forces(self, rows: Rows) -> None:
        joints = int(rows["joints"][-1])
        if joints == 0:
            return
        known = math.isfinite(self._limit_N)
        limit = self._limit_N if known else self._config.tension_scale_N
        top, height, places = compute_force_rows(joints)
        two_way = [len(self._sheaths.list_tendons(joint)) > 1 for joint in range(joints)]
        self._placed = places, two_way
        if self._framed != (limit, two_way):
            self._framed = limit, two_way
            self._draw_words(
                top, height, f"{'limit' if known else 'scale'} {format_force(limit)} N"
            )
            for joint, place in enumerate(places):
                self._draw_frame(
                    joint, "" if joints == 1 else f"joint {joint + 1}", place, two_way[joint]
                )
        bars, numbers = self._bar_rows(rows), self._number_rows(rows)
        for joint, place in enumerate(places):
            if len(bars):
                self._draw_bar(joint, place, bars, bars["force"][:, joint] / limit, two_way[joint])
            if len(numbers):
                self._draw_number(joint, place, numbers, numbers["force"][:, joint])

    def _forget_forces(self, stamp_ns: int) -> None:
        """Write that no force is known, from one instant on."""
        self._force_ns = None
        unknown = np.array([(stamp_ns, math.nan)], [("stamp_ns", np.int64), ("force", np.float64)])
        places, two_way = self._placed
        for joint, place in enumerate(places):
            self._draw_bar(joint, place, unknown, unknown["force"], two_way[joint])
            self._draw_number(joint, place, unknown, unknown["force"])

    def _draw_bar(
        self, joint: int, place: ForceRow, rows: Rows, shares: Array, two_way: bool
    ) -> None:
        """Draw a force, as shares of its limit, at the stamps of `rows`."""
        boxes = [fill_box(place.place_bar(float(share), two_way)) for share in shares]
        strips = [lines for lines, _ in boxes]
        inks = [choose_force_colour(float(share)) for share in shares]
        self._draw_strips(f"panel/joint_{joint}/bar", rows["stamp_ns"], strips, inks, boxes[0][1])

    def _draw_number(self, joint: int, place: ForceRow, rows: Rows, forces: Array) -> None:
        """Write a force [N] at the stamps of `rows`."""
        texts = [format_force(float(force)) for force in forces]
        strips = [
            build_text_strips(
                text,
                place.number_right - compute_text_width(text, place.number_height),
                place.number_top,
                place.number_height,
            )
            for text in texts
        ]
        radius = STROKE * place.number_height
        inks = [PLAIN] * len(rows)
        self._draw_strips(f"panel/joint_{joint}/number", rows["stamp_ns"], strips, inks, radius)

    def _draw_words(self, top: float, height: float, end: str) -> None:
        """Write what the forces are, and where their bars end."""
        strips = build_text_strips("force at the tip", _MARGIN, top, height)
        strips += build_text_strips(
            end, ForceRow.bar_right - compute_text_width(end, height), top, height
        )
        words = rr.LineStrips2D(strips, colors=PLAIN, radii=STROKE * height, draw_order=2.0)
        self._sender.send_static("panel/words", words)

    def _draw_frame(self, joint: int, name: str, place: ForceRow, two_way: bool) -> None:
        """Draw what of a force stands still: its name, its unit and the frame of the bar."""
        strips = build_text_strips(name, _MARGIN, place.name_top, place.name_height)
        radii = [STROKE * place.name_height] * len(strips)
        tall = 0.5 * place.number_height
        unit = place.number_right + place.unit_gap * place.number_height
        strips += build_text_strips("N", unit, place.number_top + tall, tall)
        radii += [STROKE * tall] * (len(strips) - len(radii))
        words = rr.LineStrips2D(strips, colors=PLAIN, radii=radii, draw_order=2.0)
        self._sender.send_static(f"panel/joint_{joint}/words", words)
        frame = rr.LineStrips2D(
            place.build_frame(two_way), colors=0x808080FF, radii=0.03, draw_order=3.0
        )
        self._sender.send_static(f"panel/joint_{joint}/frame", frame)

    def _update_link(self, rows: Rows) -> None:
        for number, own in split_rows(rows, "role").items():
            if number not in (Role.MASTER, Role.SLAVE):
                continue
            role, before = Role(number), dict(self._counts)
            newest = own[-1]
            lost = int(newest["lost"]) + int(newest["rejected"])
            self._counts[role] = LinkCounts(int(newest["received"]), lost)
            if role is Role.MASTER and newest["latency_p50_ns"] > 0:
                self._latency_ms = float(newest["latency_p50_ns"]) * 1e-6
            self._no_reception[role] = role in before and before[role] == self._counts[role]
            no_reception = any(self._no_reception.values())
            quality = compute_link_quality(before, self._counts, self._latency_ms, no_reception)
            self._draw_quality(quality, int(newest["stamp_ns"]))

    def _update_link_limits(self, rows: Rows) -> None:
        for number, own in split_rows(rows, "role").items():
            if number not in (Role.MASTER, Role.SLAVE):
                continue
            newest, role = own[-1], Role(number)
            if role is Role.MASTER:
                jitter_ns = int(newest["jitter_ns"])
                self._jitter_ms = None if jitter_ns < 0 else jitter_ns * 1e-6
            scaled = "" if newest["scale"] >= 1.0 else f"scaled to {100 * newest['scale']:.0f} %"
            self._allowed[role] = "held" if newest["holds"] else scaled

    def _draw_quality(self, quality: LinkQuality, stamp_ns: int) -> None:
        parts = format_link_parts(quality, self._jitter_ms, self._allowed.values())
        strips = [
            strip
            for left, text in zip(LINK_LEFT, parts, strict=True)
            for strip in build_text_strips(text, left, LINK_TOP, LINK_HEIGHT)
        ]
        ink, radius = QUALITIES[quality.word], STROKE * LINK_HEIGHT
        self._draw_at("panel/link", stamp_ns, strips, ink, radius)

    def _draw_centred(
        self, path: str, stamp_ns: int, text: str, top: float, height: float, colour: int
    ) -> None:
        height = fit_height(text, PANEL_WIDTH - 2 * _MARGIN, height)
        strips = build_text_strips(
            text, (PANEL_WIDTH - compute_text_width(text, height)) / 2, top, height
        )
        self._draw_at(path, stamp_ns, strips, colour, STROKE * height)

    def _draw_at(
        self, path: str, stamp_ns: int, strips: list[Array], colour: int, radius: float
    ) -> None:
        """Draw strips from one instant on."""
        self._draw_strips(path, np.array([stamp_ns], np.int64), [strips], [colour], radius)

    def _draw_strips(
        self,
        path: str,
        stamps_ns: NDArray[np.int64],
        drawings: Sequence[list[Array]],
        inks: Sequence[int],
        radius: float,
    ) -> None:
        """Draw one drawing of strips at each stamp, in place of the one before; none clears it."""
        order = 0.0 if path.endswith(("area", "bar")) else 1.0
        self._sender.send_once(path, rr.LineStrips2D.from_fields(draw_order=order))
        counts = [len(strips) for strips in drawings]
        drawn = build_columns(
            rr.LineStrips2D,
            np.array(counts),
            strips=list(chain.from_iterable(drawings)),
            colors=np.repeat(np.array(inks, np.uint32), counts),
            radii=np.full(sum(counts), radius),
        )
        self._sender.send_columns_at(path, stamps_ns, drawn)


def format_force(force: float) -> str:
    """Return a force [N] in at most five characters, up to 9999 N; dashes if it is not known."""
    if not math.isfinite(force):
        return "---"
    return f"{force:.1f}" if abs(force) < 99.95 else f"{force:.0f}"


def format_link_parts(
    quality: LinkQuality, jitter_ms: float | None, allowed: Iterable[str]
) -> tuple[str, str, str, str]:
    """Return what is said of the link; nothing of what is not known.

    What the link allows, where that is not all, stands in the place of the jitter.
    """
    if quality.word == NO_LINK:
        return "no link", "", "", ""
    delay, jitter = (
        f"{word} {_format_milliseconds(value)}" if value is not None else ""
        for word, value in (("delay", quality.latency_ms), ("jitter", jitter_ms))
    )
    limited = next((text for text in allowed if text), "")
    return f"link {quality.word}", f"{100 * quality.loss:.1f} % lost", delay, limited or jitter


def _format_milliseconds(value: float) -> str:
    return f"{value:.1f} ms" if value < 9.95 else f"{min(value, 9999.0):.0f} ms"
