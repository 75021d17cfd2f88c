"""Table of the curves over time."""

from dataclasses import dataclass
from typing import Any, Literal

from teleop.messages.messages import STAGE_NAMES
from teleop.messages.topics import (
    COMMAND,
    HAND,
    LATENCY,
    LEDGER,
    LINK,
    REPORT,
    STATE,
    TENDONS,
    Topic,
)
from teleop.view import colours

STAGE_COLOURS = (colours.HAND, colours.HOUSING, colours.ESTIMATE, colours.COMMANDED, colours.TRUTH)
# [points] of a curve below another that is nearly equal: seen on both sides of it
UNDERLAY_WIDTH = 4.0
LOSS, LATENESS = colours.PHASES[2], colours.PHASES[4]


@dataclass(frozen=True, slots=True)
class Curve:
    """A field of a message as a curve.

    `path` is the entity; `{}` in it stands for the tendon, the joint or the role. Non-finite values
    are not sent (e.g. of a missing bench sensor).
    """

    path: str
    field: str
    name: str  # in the legend: measured, estimated, commanded or true where it is one of these
    colour: int  # 0xRRGGBBAA
    width: float = 1.5  # [points]
    factor: float = 1.0  # shown = factor * field
    positive_only: bool = False  # 0 and below mean "none"
    entry: int | None = None  # of an array field, where the group is not over its entries
    behind: bool = False  # in a tab that is not in front at first: a live page grows it less often


@dataclass(frozen=True, slots=True)
class Band:
    """The area between two fields of a message, behind the curves.

    Rerun's plots fill no area, so it is drawn as one line that goes up and down within each row's
    period, as broad as a period is on the screen.
    """

    path: str  # as in `Curve`; plots draw entities in alphabetical order, so it comes first
    low: str
    high: str
    name: str


@dataclass(frozen=True, slots=True)
class CurveGroup:
    """The curves drawn from one topic, and what their fields are arrays over."""

    over: Literal["tendon", "joint", "role", "role and joint", "sender"]
    curves: tuple[Curve, ...]
    bands: tuple[Band, ...] = ()


_MS = 1e-6  # of nanoseconds
MILLI = 1e3  # of metres, of joules

CURVES: dict[Topic[Any], tuple[CurveGroup, ...]] = {
    TENDONS: (CurveGroup(
        "tendon",
        (
            Curve("tension/{}/in", "proximal_tension", "measured", colours.HOUSING),
            Curve("tension/{}/out", "distal_tension", "estimated",
                  colours.ESTIMATE, UNDERLAY_WIDTH),
            Curve("tension/{}/out_true", "bench_distal_tension", "true", colours.TRUTH),
            Curve("displacement/{}/in", "proximal_displacement", "measured",
                  colours.HOUSING, factor=MILLI, behind=True),
            Curve("displacement/{}/asked", "commanded_displacement", "commanded",
                  colours.COMMANDED, factor=MILLI, behind=True),
            Curve("displacement/{}/out_true", "bench_distal_displacement", "true",
                  colours.TRUTH, UNDERLAY_WIDTH, factor=MILLI),
            Curve("elongation/{}", "elongation", "estimated", colours.ESTIMATE, factor=MILLI,
                  behind=True),
        ),
    ),),
    STATE: (
        CurveGroup(
            "joint",
            (
                Curve("force/{}/tip", "force", "estimated", colours.ESTIMATE, UNDERLAY_WIDTH),
                Curve("position/{}/tip", "position", "estimated", colours.ESTIMATE,
                      2.0, factor=MILLI),
            ),
            (Band("force/{}/interval", "force_low", "force_high", "interval"),),
        ),
        CurveGroup(
            "sender",
            (
                Curve("age/slave/sample", "sample_age_ns", "newest sample", LATENESS, factor=_MS,
                      behind=True),
            ),
        ),
    ),
    HAND: (
        CurveGroup(
            "joint",
            (
                Curve("hand/{}/force", "force", "commanded", colours.HAND, 2.0, behind=True),
            ),
        ),
        CurveGroup(
            "sender",
            (
                Curve("age/master/state", "state_age_ns", "newest state", colours.HAND,
                      factor=_MS, positive_only=True, behind=True),
                Curve("age/master/round_trip", "round_trip_ns", "round trip", colours.COMMANDED,
                      factor=_MS, positive_only=True, behind=True),
            ),
        ),
    ),
    COMMAND: (
        CurveGroup(
            "joint",
            (Curve("position/{}/asked", "position", "commanded", colours.COMMANDED, factor=MILLI),),
        ),
    ),
    LEDGER: (CurveGroup(
        "role and joint",
        (
            Curve("energy/{}/put_in", "put_in", "put in", colours.HOUSING,
                  factor=MILLI, behind=True),
            Curve("energy/{}/taken_out", "taken_out", "taken out", colours.TRUTH,
                  factor=MILLI, behind=True),
            Curve("energy/{}/heard", "received", "received", colours.ESTIMATE,
                  factor=MILLI, behind=True),
            Curve("energy/{}/dissipated", "dissipated", "dissipated", LOSS,
                  factor=MILLI, behind=True),
            Curve("energy/{}/credit", "credit", "credit", colours.HAND, 2.0,
                  factor=MILLI, behind=True),
        ),
    ),),
    REPORT: (CurveGroup(
        "role",
        (
            Curve("rate/{}", "rate_hz", "rate", colours.HOUSING, behind=True),
            Curve("latency/{}/p50", "latency_p50_ns", "median", colours.ESTIMATE, 2.0, factor=_MS,
                  positive_only=True, behind=True),
            Curve("latency/{}/p99", "latency_p99_ns", "99 %", colours.INTERVAL, factor=_MS,
                  positive_only=True, behind=True),
            Curve("latency/{}/late", "lateness_max_ns", "latest tick", LATENESS, factor=_MS,
                  behind=True),
            Curve("loss/{}/lost", "lost", "lost", LOSS, behind=True),
            Curve("loss/{}/rejected", "rejected", "rejected", colours.COMMANDED, behind=True),
            Curve("loss/{}/overruns", "overruns", "overruns", colours.TRUTH, behind=True),
        ),
    ),),
    LINK: (CurveGroup(
        "role",
        (
            Curve("latency/{}/round_trip", "round_trip_ns", "round trip", colours.HAND, factor=_MS,
                  positive_only=True, behind=True),
            Curve("latency/{}/jitter", "jitter_ns", "jitter", colours.COMMANDED, factor=_MS,
                  positive_only=True, behind=True),
        ),
    ),),
    LATENCY: (CurveGroup(
        "sender",
        tuple(
            Curve(f"budget/{{}}/{k}", "p50_ns", name, colour, factor=_MS, entry=k,
                  positive_only=True, behind=True)
            for k, (name, colour) in enumerate(zip(STAGE_NAMES, STAGE_COLOURS, strict=True))
        ),
    ),),
}  # fmt: skip
