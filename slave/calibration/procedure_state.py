"""Inputs and state of the initialisation of a joint; detectors of a stop and a stuck cell."""

import math
from enum import IntEnum
from typing import NamedTuple

from slave.calibration.config import InitialiseConfig
from slave.gate import GateFlags

# --- detect a saturated load cell
# Its reading stays constant while the motor pulls on. Without noise or with a coarse converter that
# also happens while the joint moves freely, so the motor then goes back a few micrometres: the
# tension falls at once, and a cell that does not measure it is saturated.


REPEATS_MIN = 5  # alike
TRAVEL_MIN = 2e-4  # [m] that the motor has pulled meanwhile


class CellState(NamedTuple):
    """State of one load cell: the newest reading and how often it was repeated."""

    reading: float = math.nan  # [N] newest
    alike: int = 0  # how often it was repeated
    since: float = math.nan  # [m] motor travel at its first occurrence


def update_cell_state(cell: CellState, reading: float, travel: float) -> CellState:
    """Return the state after a new reading [N] at a motor travel [m]."""
    if reading == cell.reading:
        return cell._replace(alike=cell.alike + 1)
    return CellState(reading, 0, travel)


def is_cell_stuck(cell: CellState, travel: float) -> bool:
    """Return whether the reading stayed constant although the motor pulled on to `travel` [m]."""
    return cell.alike >= REPEATS_MIN and travel - cell.since > TRAVEL_MIN


# --- local stiffness of a tendon from tension over motor travel, to detect an end stop
# While the joint moves freely the tension hardly rises with motor travel; at the stop every
# millimetre stretches the tendon. The slope is that of a straight line fitted to the latest
# `window` of travel, older travel with exponentially decaying weight. No single sample decides, and
# a resting motor changes nothing.


_SPREAD_MIN = 0.1  # of the window's own spread: with less travel the slope is not defined


class Trend(NamedTuple):
    """Weighted means and moments of travel [m] and tension [N]; weights decay over `window`."""

    travel: float
    tension: float
    variance: float = 0.0  # [m^2] of travel
    covariance: float = 0.0  # [m N]
    newest: float = math.nan  # [m] travel of the newest sample used


def init_trend(travel: float, tension: float) -> Trend:
    """Return the trend of a single sample."""
    return Trend(travel, tension, newest=travel)


def update_trend(
    trend: Trend, travel: float, tension: float, direction: float, window: float
) -> Trend:
    """Return the trend after a sample; `direction` is +1 while pulling and -1 while releasing.

    Its weight is the travel since the last one, so speed and rate do not matter; samples without
    forward travel are ignored.
    """
    advance = direction * (travel - trend.newest)
    if not advance > 0.0:
        return trend
    weight = -math.expm1(-advance / window)
    dq, dT = travel - trend.travel, tension - trend.tension
    return Trend(
        trend.travel + weight * dq,
        trend.tension + weight * dT,
        (1.0 - weight) * (trend.variance + weight * dq * dq),
        (1.0 - weight) * (trend.covariance + weight * dq * dT),
        travel,
    )


def compute_stiffness(trend: Trend, window: float) -> float:
    """Return dT/dq [N/m], infinite while there is too little travel."""
    if trend.variance < (_SPREAD_MIN * window) ** 2:
        return math.inf
    return trend.covariance / trend.variance


Tendons = tuple[float, ...]
TENDON_NAMES = ("a", "b")


def format_tendon_name(joint: int, tendons: int, tendon: int) -> str:
    """Return the name of a tendon in messages: joints count from 1, tendons are a and b."""
    return f"joint {joint}, tendon {TENDON_NAMES[tendon]}" if tendons > 1 else f"joint {joint}"


class Phase(IntEnum):
    """Phases of the procedure, with a text for the operator."""

    text: str

    def __new__(cls, number: int, text: str) -> "Phase":
        """Attach the text, `phase.text`."""
        phase = int.__new__(cls, number)
        phase._value_ = number
        phase.text = text
        return phase

    TAKE_UP = 0, "taking up"
    SEEK = 1, "seeking the stop"
    PROBE = 2, "testing the load cell"
    SLACKEN = 3, "slackening the other tendon"
    RELEASE = 4, "releasing"
    PULL = 5, "pulling"
    DRAG = 6, "dragging"
    RETURN = 7, "going back"
    SETTLE = 8, "settling"
    DONE = 9, "done"
    RELAX = 10, "lowering the tensions"
    REFUSED = 11, "refused"
    MOVE = 12, "moving to a posture"
    HOLD = 13, "holding"


class ProcedureRefused(Exception):
    """A reason to abort the procedure, with the remedy."""


class JointReadings(NamedTuple):
    """Measurements of one joint at a tick; one entry per tendon."""

    tension: Tendons  # [N] newest at the housing
    travel: Tendons  # [m] newest of the encoders
    motor: Tendons  # [m] last output of the gate
    verdict: GateFlags = GateFlags.PASSED  # of the gate at the last tick
    fresh: bool = True  # whether tension and travel are new


class StopContact(NamedTuple):
    """The contact with a stop, and the compliance of the tendon pulled against it."""

    travel: float  # [m] of the motor
    tension: float  # [N] at the housing, a little after the joint moved freely
    compliance: float = 0.0  # [m/N]


class JointConstants(NamedTuple):
    """Constants of a joint for the procedure."""

    number: int  # from 1
    compliance: Tendons  # [m/N] of each tendon: upper bound at a stop
    is_staged: bool = False  # whether it holds after each stage, for `slave.calibration.posture`


class ProcedureState(NamedTuple):
    """State of the procedure of a joint between ticks."""

    phase: Phase = Phase.TAKE_UP
    side: int = 0  # the tendon that is pulled; of a pair, 2 and 3 are a and b again, in drags
    releases: int = 0  # ended on this side
    elapsed: float = 0.0  # [s] in this phase
    origin: Tendons = ()  # [m] travel when the phase began
    tension: Tendons = ()  # [N] smoothed
    trend: Trend | None = None
    contact: StopContact | None = None  # last point at which the pulled tendon was soft
    stops: tuple[StopContact, ...] = ()  # found so far, one per side
    lane: float = 0.0  # [m] length of this drag, or what is left of this move
    hold: float = (
        0.0  # [N] of the tendon that ends a move at a stop; 0 = a move to within the range
    )
    easing: bool = False  # in a drag: the other tendon is paid out faster than it is drawn
    home: Tendons = ()  # [m] travel when all tendons were taut for the first time
    lowest: float = math.inf  # [m] travel of the other tendon in this phase
    highest: float = 0.0  # [N] smoothed tension of the pulled tendon in this phase
    cells: tuple[CellState, ...] = ()
    tried: float = -math.inf  # [m] travel at which the pulled tendon's load cell last responded
    steady: float = 0.0  # [s] for which all tendons have had their target tension
    blocked: Tendons = ()  # [s] for which the gate has blocked each motor
    moved: Tendons = ()  # [m] last commanded motion of each motor, and its start
    before: Tendons = ()  # [m]
    refusal: str = ""  # reason of the abort


def begin_phase(memory: ProcedureState, phase: Phase, sample: JointReadings) -> ProcedureState:
    """Return the state at the start of a phase."""
    return memory._replace(
        phase=phase,
        elapsed=0.0,
        origin=sample.travel,
        trend=None,
        lowest=math.inf,
        highest=0.0,
        steady=0.0,
        blocked=(0.0,) * len(sample.motor),
        moved=(),
        before=(),
    )


def abort_procedure(memory: ProcedureState, sample: JointReadings, reason: str) -> ProcedureState:
    """Return the state of an aborted procedure, which lowers the tensions and then holds."""
    return begin_phase(memory._replace(refusal=memory.refusal or reason), Phase.RELAX, sample)


def is_ended(memory: ProcedureState) -> bool:
    """Return whether the procedure, or this stage of it, has ended."""
    return memory.phase in (Phase.DONE, Phase.REFUSED, Phase.HOLD)


def compute_progress(config: InitialiseConfig, memory: ProcedureState) -> float:
    """Return the fraction of the phases that a joint has completed, 0 to 1."""
    if memory.phase is Phase.DONE:
        return 1.0
    a_side = 2 * config.loops + 4  # taking up, seeking, loosening, and the releases and pulls
    steps_in_phase = {
        Phase.SEEK: 1,
        Phase.PROBE: 1,
        Phase.SLACKEN: 2,
        Phase.RELEASE: 3,
        Phase.PULL: 2,
        Phase.DRAG: memory.side - 1,
        Phase.RETURN: 1,
        Phase.SETTLE: 3,
    }
    step = steps_in_phase.get(memory.phase, 0)
    if memory.phase in (Phase.RELEASE, Phase.PULL):
        step += 2 * memory.releases
    sides = 2  # at most
    return (min(memory.side, sides) * a_side + step) / (sides * a_side + 4)
