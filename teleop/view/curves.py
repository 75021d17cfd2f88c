"""The curves over time: one line for each number that is drawn against time."""

from dataclasses import dataclass
from typing import Any, Literal

from teleop.topics import COMMAND, HAND, REPORT, STATE, TENDONS, Topic

GREEN, BLUE, PALE_BLUE, ORANGE, RED, GREY = (
    0x2CA02CFF, 0x1F77B4FF, 0x9DC7E6FF, 0xFF7F0EFF, 0xD62728FF, 0x808080FF,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Curve:
    """A field of a message as a curve.

    `path` is the entity; `{}` in it stands for the tendon, the joint or the role. Values that are
    not finite are not sent (a bench sensor that is not there draws nothing).
    """

    path: str
    field: str
    name: str  # in the legend, where the tendon, joint or role follows it; the view has the unit
    colour: int  # 0xRRGGBBAA
    width: float = 1.5  # [points]
    factor: float = 1.0  # shown = factor * field
    positive_only: bool = False  # 0 and below stand for "none"


@dataclass(frozen=True, slots=True)
class CurveGroup:
    """The curves drawn from one topic, and what their fields are arrays over."""

    over: Literal["tendon", "joint", "role"]
    curves: tuple[Curve, ...]


CURVES: dict[Topic[Any], CurveGroup] = {
    TENDONS: CurveGroup(
        "tendon",
        (
            Curve("tension/{}/in", "proximal_tension", "T_in", GREEN),
            Curve("tension/{}/out", "distal_tension", "T_out", BLUE, 2.0),
            Curve("tension/{}/out_low", "distal_tension_low", "T_out low", PALE_BLUE, 1.0),
            Curve("tension/{}/out_high", "distal_tension_high", "T_out high", PALE_BLUE, 1.0),
            Curve("tension/{}/out_measured", "bench_distal_tension", "T_out bench", ORANGE),
            Curve("displacement/{}/in", "proximal_displacement", "q_p", GREEN),
            Curve("displacement/{}/asked", "commanded_displacement", "q_p asked", GREY),
            Curve("displacement/{}/out_measured", "bench_distal_displacement", "q_d", ORANGE),
            Curve("displacement/{}/elongation", "elongation", "e", BLUE),
            Curve("front/{}", "front", "X'", RED),
        ),
    ),
    STATE: CurveGroup(
        "joint",
        (
            Curve("force/{}/tip", "force", "tip", BLUE, 2.0),
            Curve("force/{}/tip_low", "force_low", "tip low", PALE_BLUE, 1.0),
            Curve("force/{}/tip_high", "force_high", "tip high", PALE_BLUE, 1.0),
            Curve("position/{}/tip", "position", "tip", BLUE),
        ),
    ),
    HAND: CurveGroup(
        "joint",
        (
            Curve("force/{}/hand", "force", "hand", RED, 2.0),
            Curve("position/{}/hand", "position", "hand", GREEN),
        ),
    ),
    COMMAND: CurveGroup("joint", (Curve("position/{}/asked", "position", "tip asked", GREY),)),
    REPORT: CurveGroup(
        "role",
        (
            Curve("loop/{}/rate_hz", "rate_hz", "rate [Hz]", GREEN),
            Curve("loop/{}/overruns", "overruns", "overruns", ORANGE),
            Curve("loop/{}/lost", "lost", "lost", RED),
            Curve("loop/{}/rejected", "rejected", "rejected", GREY),
            Curve("loop/{}/lateness_ms", "lateness_max_ns", "lateness [ms]", BLUE, factor=1e-6),
            Curve("loop/{}/latency_p50_ms", "latency_p50_ns", "latency, median [ms]", BLUE,
                  factor=1e-6, positive_only=True),
            Curve("loop/{}/latency_p99_ms", "latency_p99_ns", "latency, 99 % [ms]", PALE_BLUE,
                  factor=1e-6, positive_only=True),
        ),
    ),
}  # fmt: skip
