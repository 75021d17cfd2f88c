"""The online estimator of one tendon: from what the housing measures to what the tip feels.

`step` is pure: prepared model, state, one sample and its dt go in; an estimate and the next state
come out. `run` does the same to a whole record with the same compiled kernel, so live operation,
replay and tests give the same numbers.

The memory is the tension profile of estimator.profile. What drives it is decided from the direction
in which the tendon slides, not from the sign of dT_in/dt (docs/theory.md (T18), (T19)). While the
motor drives, the travel of the motor is the elongation the profile predicts; the residual

    delta = dq_p - de(dT_in)

is then zero while the front is inside the sheath, and while the whole tendon slides it may only be
travel of the tip the way the tendon slides. A residual beyond noise and model error means that the
tip drives: delta > 0, its tension fell; delta < 0, its tension rose. The two measurements also tell
the depth a to which the motor end slides, dq_p/dT_in = G(a); beyond it the tip slides the tendon
the other way, so that T_out is an end of the cone of (T2) that opens at a. With T_in changing at
constant q_p, a = 0: T_in e^-K where it falls, T_in e^+K where it rises.

The interval does not rest on that decision. It is (T2), widened by the sensor noise, cut by what
motion has proved: a motor end that slid to depth a leaves the tip the cone that opens there, one
point for a = K. What was proved ages: the tip may change unseen at up to `tip_tension_rate`.
"""

import math
from dataclasses import dataclass, field
from enum import IntFlag
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimator import signals
from estimator import tables as _tables
from estimator.compiled import compiled
from estimator.profile import (
    TIP,
    log_tension,
    point,
    point_count,
    pretensioned_profile,
    push_proximal,
    slide,
    tension_of,
)
from estimator.sheath import Sheath
from estimator.tables import Tables, integral, tables
from estimator.transmission import Phase, read_out, sensitivity, tension_at

Array = NDArray[np.float64]
State: TypeAlias = NDArray[np.float64]

TENSION_FLOOR = 1e-3
"""Least noise [N] the decisions reckon with, however good the load cell is said to be."""

DISPLACEMENT_FLOOR = 2e-7
"""Least noise [m] the decisions reckon with: an encoder has counts."""


class ModelError(ValueError):
    """A tendon model that cannot be; the message names the field, the value and what is allowed."""


class Status(IntFlag):
    """What stands against an estimate; 0 is a plain one.

    TENSION_ONLY: no displacement, so the motor is taken to drive and the interval is (T2).
    UNINITIALISED: T_in has not swung by e^2K since the start, so the initial profile is assumed.
    TIP_MOVED: the sliding direction said that the tip drives, and the motor has not mobilised the
    whole tendon since. SLACK: no tension within the noise.
    INVALID_INPUT: the sample was refused, the estimate is the last one, the interval widens.
    """

    OK = 0
    TENSION_ONLY = 1
    UNINITIALISED = 2
    TIP_MOVED = 4
    SLACK = 8
    INVALID_INPUT = 16


@dataclass(frozen=True, slots=True)
class TendonModel:
    """What the estimator is told about one tendon.

    Attributes
    ----------
    sheath
        Geometry, friction and stiffness.
    tension_noise, displacement_noise
        Standard deviations of the white noise of T_in [N] and q_p [m]; `signals.noise_sigma`
        estimates them from a record at rest. Quantisation by d counts as d/sqrt(12).
    initial
        "slack", or the tension [N] along a tendon that has not slid since it was pretensioned.
    treatment
        How the tension is made fit to drive the profile.
    friction_error
        Relative error of K the interval allows for.
    elongation_error
        Relative error of the predicted elongation (of EA, mostly) the decisions allow for.
    tip_tension_rate
        How fast T_out may change unseen [N/s]; ``math.inf`` trusts only what moves right now.
    """

    sheath: Sheath
    tension_noise: float = 0.0  # [N]
    displacement_noise: float = 0.0  # [m]
    initial: Literal["slack"] | float = "slack"  # [N]
    treatment: signals.Treatment = field(default_factory=signals.Treatment)
    friction_error: float = 0.02
    elongation_error: float = 0.05
    tip_tension_rate: float = 100.0  # [N/s]

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        for name in ("tension_noise", "displacement_noise", "friction_error"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ModelError(f"{name}: {getattr(self, name)}, must be finite and not negative")
        if not 0.0 <= self.elongation_error < 1.0:
            raise ModelError(f"elongation_error: {self.elongation_error}, allowed are 0 to 1")
        if not self.tip_tension_rate >= 0.0:
            raise ModelError(f"tip_tension_rate: {self.tip_tension_rate} N/s, must not be negative")
        if isinstance(self.initial, str):
            known = self.initial == "slack"
        else:
            known = 0.0 <= self.initial < math.inf
        if not known:
            raise ModelError(f'initial: {self.initial!r}, allowed are "slack" or a tension [N]')


class Prepared(NamedTuple):
    """A model made ready for the kernel."""

    tables: Tables
    constants: Array
    initial: State


class TendonEstimate(NamedTuple):
    """One tendon at one instant."""

    distal_tension: float
    """T_out [N]."""
    low: float
    """Least T_out [N] that the data and the noise allow."""
    high: float
    """Largest T_out [N] that the data and the noise allow; inf before the first valid sample."""
    elongation: float
    """e [m]."""
    distal_displacement: float
    """q_p - e [m], positive towards the housing, up to a constant; NaN without displacement."""
    front: float
    """X' [m]."""
    phase: Phase
    """What the tendon does next to the motor."""
    status: Status
    """What stands against the estimate."""


class Estimates(NamedTuple):
    """The fields of `TendonEstimate` over a record, arrays of shape (n,)."""

    distal_tension: Array
    low: Array
    high: Array
    elongation: Array
    distal_displacement: Array
    front: Array
    phase: NDArray[np.int64]
    status: NDArray[np.int64]


def prepare(model: TendonModel) -> Prepared:
    """Return `model` made ready for `step` and `run`; compiles nothing."""
    table = tables(model.sheath)
    pretension = 0.0 if model.initial == "slack" else float(model.initial)
    profile = pretensioned_profile(table, pretension)
    constants = np.empty(_CONSTANTS)
    constants[_SIGMA_T] = model.tension_noise
    constants[_SIGMA_Q] = max(model.displacement_noise, DISPLACEMENT_FLOOR)
    constants[_TAU] = model.treatment.time_constant if model.tension_noise > 0.0 else 0.0
    constants[_BAND] = model.treatment.dead_band
    constants[_K_ERROR] = model.friction_error
    constants[_E_ERROR] = model.elongation_error
    constants[_RATE] = model.tip_tension_rate
    scalars = np.zeros(_SCALARS)
    scalars[_T_LEAST] = math.inf
    scalars[_PROVED_HIGH] = math.inf
    scalars[_HIGH] = math.inf
    return Prepared(table, constants, np.concatenate([scalars, profile]))


def initial(prepared: Prepared) -> State:
    """Return the state before the first sample."""
    return prepared.initial.copy()


def step(
    prepared: Prepared,
    state: State,
    proximal_tension: float,
    proximal_displacement: float,
    dt: float,
) -> tuple[TendonEstimate, State]:
    """Take one sample; return the estimate and the next state. `state` is left as it was.

    Parameters
    ----------
    prepared : Prepared
        From `prepare`.
    state : State
        From `initial` or the previous step.
    proximal_tension : float
        T_in measured [N].
    proximal_displacement : float
        q_p measured [m], positive = pulled in; NaN where there is none.
    dt : float
        Time since the previous sample [s]; 0 for the first.
    """
    after = state.copy()
    row = _advance(
        prepared.tables, prepared.constants, after, proximal_tension, proximal_displacement, dt
    )
    return TendonEstimate(*row[:6], _PHASES[row[6]], _STATUSES[row[7]]), after


def run(
    prepared: Prepared, time: Array, tension: Array, displacement: Array | None = None
) -> Estimates:
    """Return the estimates of a whole record: the numbers `step` gives sample for sample.

    Parameters
    ----------
    prepared : Prepared
        From `prepare`.
    time, tension, displacement : ndarray
        Sample times [s], T_in [N] and q_p [m], shape (n,); None where there is no displacement.
    """
    q = np.full(len(tension), math.nan) if displacement is None else displacement
    if not time.shape == tension.shape == q.shape or tension.ndim != 1:
        raise ModelError(
            f"time {time.shape}, tension {tension.shape}, displacement {q.shape}: "
            "give rows of equal length"
        )
    values, flags = _run(
        prepared.tables,
        prepared.constants,
        prepared.initial.copy(),
        np.ascontiguousarray(time, dtype=np.float64),
        np.ascontiguousarray(tension, dtype=np.float64),
        np.ascontiguousarray(q, dtype=np.float64),
    )
    return Estimates(*values, *flags)


def profile_at(prepared: Prepared, state: State, x: Array) -> Array:
    """Return the tension T(x) [N] the state remembers at the arc lengths `x` [m], shape (n,)."""
    return tension_at(prepared.tables, state[_SCALARS:], np.asarray(x, dtype=np.float64))


_PHASES = tuple(Phase)
_STATUSES = tuple(Status(value) for value in range(32))

_TENSION_ONLY = int(Status.TENSION_ONLY)
_UNINITIALISED = int(Status.UNINITIALISED)
_TIP_MOVED = int(Status.TIP_MOVED)
_SLACK = int(Status.SLACK)
_INVALID = int(Status.INVALID_INPUT)
_PULL, _RELEASE = int(Phase.PULL), int(Phase.RELEASE)

_K, _EA, _ASYMMETRY = _tables.K, _tables.EA, _tables.ASYMMETRY

_SIGMA_T, _SIGMA_Q, _TAU, _BAND, _K_ERROR, _E_ERROR, _RATE = range(7)
_CONSTANTS = 7

(
    _STARTED,  # a sample has been taken
    _JOINED,  # the previous sample had a displacement, so increments mean something
    _MEAN_T,  # [N] averaged tension
    _VARIANCE,  # [N^2] of the averaged tension
    _MEAN_Q,  # [m] averaged displacement, with the same lag
    _HELD,  # [N] treated tension, which drives the profile
    _HEADING,  # sign of the last change of the treated tension
    _T_LEAST,  # [N] extremes of the treated tension since the start
    _T_MOST,
    _RESIDUAL,  # [m] delta summed, fading
    _PATH,  # [m] |de| summed, fading likewise
    _ANCHOR_T,  # [N] where the residual was last small
    _ANCHOR_Q,  # [m]
    _DRIVER,  # 0 the motor; -1, +1 the tip, whose tension falls, rises
    _SIDE,  # slope of the profile next to the motor while the tip drives: -1, +rho
    _DEPTH,  # friction coordinate down to which the motor end slides while the tip drives
    _BLAMED,  # the tip has driven, and the motor has not mobilised the whole tendon since
    _WINDOW_T,  # [N] where the window of proof began
    _WINDOW_Q,  # [m]
    _WINDOW_AGE,  # [s]
    _WINDOW_T_LEAST,  # [N]
    _WINDOW_T_MOST,
    _PROVED_LOW,  # [N] T_out as proved by motion and aged since
    _PROVED_HIGH,
    _LOW,  # [N] the interval last reported
    _HIGH,
    _SCALARS,
) = range(27)

_SURE = 8.0  # sigma of a displacement before it decides: a running extreme stands 3 to 4 off
_BOUND = 4.0  # sigma that bound a single reading
_PRECISE = 10.0  # margins a window's change must exceed to be called precisely known
_WINDOW = 0.1  # [s] after which a window of proof is closed as it is
_FADING = 0.2  # of the elongation: the path over which a residual is forgotten
_NEGATIVE = 0.05  # [N] of zero offset that is not a broken load cell


@compiled
def _advance(
    table: Tables, constants: Array, state: State, T: float, q: float, dt: float
) -> tuple[float, float, float, float, float, float, int, int]:
    """Take one sample, in place; return the fields of a `TendonEstimate`."""
    profile = state[_SCALARS:]
    unheard = constants[_RATE] * dt if dt > 0.0 else 0.0
    state[_PROVED_LOW] -= unheard
    state[_PROVED_HIGH] += unheard
    sigma = constants[_SIGMA_T]
    if (
        not math.isfinite(T)
        or math.isinf(q)
        or not (0.0 <= dt < math.inf)
        or T + _NEGATIVE + 6.0 * sigma < 0.0
    ):
        status = _INVALID | (0 if _erased(table, state) else _UNINITIALISED)
        state[_JOINED] = 0.0
        state[_LOW] = max(state[_LOW] - unheard, 0.0)
        state[_HIGH] += unheard
        _, T_out, e, phase, front = read_out(table, profile)
        return T_out, state[_LOW], state[_HIGH], e, math.nan, front, phase, status

    status = 0
    tau = constants[_TAU]
    if state[_STARTED] == 0.0:
        state[_STARTED] = 1.0
        state[_MEAN_T] = state[_HELD] = T
        state[_VARIANCE] = sigma * sigma
    mean = signals.average(state[_MEAN_T], T, dt, tau)
    state[_VARIANCE] = signals.averaged_variance(state[_VARIANCE], sigma, dt, tau)
    sigma_mean = math.sqrt(state[_VARIANCE])
    band = constants[_BAND] * sigma_mean
    held = signals.play(state[_HELD], mean, band)
    state[_MEAN_T] = mean
    slack = mean <= 3.0 * max(sigma_mean, TENSION_FLOOR)
    if slack:
        held = 0.0
        status |= _SLACK
    state[_T_LEAST] = min(state[_T_LEAST], held)
    state[_T_MOST] = max(state[_T_MOST], held)

    if math.isnan(q):
        status |= _TENSION_ONLY
        state[_JOINED] = 0.0
        state[_DRIVER] = state[_BLAMED] = 0.0
        state[_PROVED_LOW], state[_PROVED_HIGH] = 0.0, math.inf
        state[_HELD] = held
        push_proximal(table, profile, held)
    else:
        fresh = state[_JOINED] == 0.0 or slack
        mean_q = q if fresh else signals.average(state[_MEAN_Q], q, dt, tau)
        if fresh:
            _anchor(state, held, mean_q)
            _open_window(state, mean, mean_q)
            state[_MEAN_Q], state[_JOINED] = mean_q, 1.0
            state[_DRIVER] = state[_BLAMED] = 0.0
            state[_HELD] = held
            push_proximal(table, profile, held)
        else:
            _follow(table, constants, state, held, mean_q, band + _BOUND * sigma_mean)
            _prove(table, constants, state, mean, mean_q, sigma_mean, dt)
        if state[_BLAMED] != 0.0:
            status |= _TIP_MOVED
    if not _erased(table, state):
        status |= _UNINITIALISED

    margin = _BOUND * sigma
    K = table[_K] * (1.0 + constants[_K_ERROR])
    low = tension_of(table, log_tension(table, min(mean, T, held) - margin) - K)
    high = tension_of(
        table, log_tension(table, max(mean, T, held) + margin) + table[_ASYMMETRY] * K
    )
    if state[_PROVED_LOW] > state[_PROVED_HIGH]:
        state[_PROVED_LOW], state[_PROVED_HIGH] = 0.0, math.inf
    if max(low, state[_PROVED_LOW]) <= min(high, state[_PROVED_HIGH]):
        low, high = max(low, state[_PROVED_LOW]), min(high, state[_PROVED_HIGH])
    state[_LOW], state[_HIGH] = low, high

    _, T_out, e, phase, front = read_out(table, profile)
    if not low <= T_out <= high:
        slide(table, profile, log_tension(table, min(max(T_out, low), high)), TIP)
        _, T_out, e, phase, front = read_out(table, profile)
        T_out = min(max(T_out, low), high)
    return T_out, low, high, e, q - e, front, phase, status


@compiled
def _erased(table: Tables, state: State) -> bool:
    """Return whether T_in has swung so far since the start that the first profile is forgotten."""
    swing = math.exp((1.0 + table[_ASYMMETRY]) * table[_K])
    drag = table[_tables.DRAG]
    least = max(state[_T_LEAST], TENSION_FLOOR)
    erased: bool = state[_T_MOST] + drag >= swing * (least + drag)
    return erased


@compiled
def _anchor(state: State, T: float, q: float) -> None:
    """Begin a residual anew at (T, q)."""
    state[_RESIDUAL] = state[_PATH] = 0.0
    state[_ANCHOR_T], state[_ANCHOR_Q] = T, q


@compiled
def _follow(
    table: Tables, constants: Array, state: State, T: float, q: float, margin_T: float
) -> None:
    """Move the profile to T_in = `T`, driven by whichever end the displacement tells."""
    profile = state[_SCALARS:]
    before = state[_HELD]
    rise = T - before
    heading = math.copysign(1.0, rise) if rise != 0.0 else state[_HEADING]
    if heading != state[_HEADING]:
        state[_DRIVER] = 0.0
        _anchor(state, before, state[_MEAN_Q])
    dq = q - state[_MEAN_Q]
    state[_HEADING], state[_HELD], state[_MEAN_Q] = heading, T, q
    _, _, e_before, _, _ = read_out(table, profile)
    push_proximal(table, profile, T)
    _, _, e, phase, _ = read_out(table, profile)
    _, compliance = sensitivity(table, profile)
    least, most = -math.inf, math.inf  # of the residual: sliding all along, the tip may travel
    if state[_DRIVER] == 0.0:
        expected = e - e_before
        if phase in (_PULL, _RELEASE):
            state[_BLAMED] = 0.0
        if phase == _PULL:
            most = 0.0
        elif phase == _RELEASE:
            least = 0.0
    else:
        _drive_tip(table, state)
        depth, side = state[_DEPTH], state[_SIDE]
        compliance = integral(table, depth, side) / table[_EA]
        expected = compliance * (T - before)
        if depth >= table[_K]:
            most, least = (0.0, least) if side < 0.0 else (most, 0.0)
    _, _, e, _, _ = read_out(table, profile)
    fading = math.exp(-abs(expected) / max(_FADING * e, _SURE * constants[_SIGMA_Q]))
    residual = min(max(fading * state[_RESIDUAL] + dq - expected, least), most)
    state[_RESIDUAL] = residual
    state[_PATH] = fading * state[_PATH] + abs(expected)
    margin = (
        _SURE * constants[_SIGMA_Q]
        + compliance * (margin_T + _BOUND * TENSION_FLOOR)
        + constants[_E_ERROR] * state[_PATH]
    )
    if abs(residual) <= 0.5 * margin:
        state[_ANCHOR_T], state[_ANCHOR_Q] = T, q
    elif abs(residual) > margin:
        if state[_DRIVER] == 0.0:
            _blame_tip(table, constants, state)
        else:
            # The motor moves again, since the anchor: replay from there.
            state[_DRIVER] = 0.0
            push_proximal(table, profile, state[_ANCHOR_T])
            push_proximal(table, profile, T)
        _anchor(state, T, q)


@compiled
def _blame_tip(table: Tables, constants: Array, state: State) -> None:
    """Let the tip drive: which way, and from what depth, follows from the residual's window."""
    dT = state[_HELD] - state[_ANCHOR_T]
    dq = state[_MEAN_Q] - state[_ANCHOR_Q]
    fell = state[_RESIDUAL] > 0.0
    motor_side, tip_side = -1.0, table[_ASYMMETRY]
    state[_DRIVER] = -1.0 if fell else 1.0
    state[_BLAMED] = 1.0
    if abs(dq) <= _BOUND * constants[_SIGMA_Q]:
        state[_SIDE], state[_DEPTH] = (tip_side if fell else motor_side), 0.0
    else:
        state[_SIDE] = motor_side if dq > 0.0 else tip_side
        state[_DEPTH] = table[_K] if dT * dq <= 0.0 else _depth(table, state[_SIDE], dq / dT)
    _drive_tip(table, state)
    if 0.0 < state[_DEPTH] < table[_K]:
        # The motor slides a part itself: whether the tip still moves, the next residual tells.
        state[_DRIVER] = 0.0


@compiled
def _drive_tip(table: Tables, state: State) -> None:
    """Bring T_out where the tendon slides away from the depth down to which the motor slides it."""
    profile = state[_SCALARS:]
    side = state[_SIDE]
    beyond = table[_ASYMMETRY] if side < 0.0 else -1.0
    y = log_tension(table, state[_HELD])
    y += side * state[_DEPTH] + beyond * (table[_K] - state[_DEPTH])
    _, y_out, _ = point(profile, point_count(profile) - 1)
    if (y - y_out) * state[_DRIVER] > 0.0:
        slide(table, profile, y, TIP)


@compiled
def _depth(table: Tables, side: float, compliance: float) -> float:
    """Return the depth a with G(a)/EA = `compliance` [m/N], at most K (T7)."""
    target = compliance * table[_EA]
    low, high = 0.0, table[_K]
    if target >= integral(table, high, side):
        return float(high)
    for _ in range(50):
        middle = 0.5 * (low + high)
        if integral(table, middle, side) < target:
            low = middle
        else:
            high = middle
    return low


@compiled
def _open_window(state: State, T: float, q: float) -> None:
    state[_WINDOW_T] = state[_WINDOW_T_LEAST] = state[_WINDOW_T_MOST] = T
    state[_WINDOW_Q], state[_WINDOW_AGE] = q, 0.0


@compiled
def _prove(
    table: Tables,
    constants: Array,
    state: State,
    T: float,
    q: float,
    sigma_mean: float,
    dt: float,
) -> None:
    """Cut the proved interval of T_out by how deep the motor end slides at least.

    Over a window in which T_in went one way, dq_p >= G(a) dT_in says that at some time the front
    was at a or deeper. What of dT_in the noise hides counts against it.
    """
    state[_WINDOW_AGE] += dt
    dT, dq = T - state[_WINDOW_T], q - state[_WINDOW_Q]
    margin_q = _BOUND * math.sqrt(2.0) * constants[_SIGMA_Q]
    margin_T = _BOUND * (math.sqrt(2.0) * sigma_mean + TENSION_FLOOR)
    least = state[_WINDOW_T_LEAST] = min(T, state[_WINDOW_T_LEAST])
    most = state[_WINDOW_T_MOST] = max(T, state[_WINDOW_T_MOST])
    turned = most - least - abs(dT)
    if turned > margin_T:
        _open_window(state, T, q)
    elif abs(dq) > 2.0 * margin_q:
        side = -1.0 if dq > 0.0 else table[_ASYMMETRY]
        sure_q = (abs(dq) - margin_q) * (1.0 - constants[_E_ERROR])
        along = max(math.copysign(dT, dT * dq), 0.0)  # of dT, what slides the way the motor went
        sure_T = along + turned + 2.0 * margin_T
        compliance = sure_q / sure_T
        full = compliance * table[_EA] >= integral(table, table[_K], side)
        precise = abs(dq) > _PRECISE * margin_q and abs(dT) > _PRECISE * margin_T
        if not (full or precise or state[_WINDOW_AGE] > _WINDOW):
            return
        margin = _BOUND * constants[_SIGMA_T]
        least, most = max(least - margin, 0.0), most + margin
        depth = _depth(table, side, compliance)
        slack_K = constants[_K_ERROR] * table[_K]
        rest = table[_K] - depth + slack_K
        low = tension_of(table, log_tension(table, least) + side * depth - rest)
        high = tension_of(table, log_tension(table, most) + side * depth + table[_ASYMMETRY] * rest)
        unheard = constants[_RATE] * state[_WINDOW_AGE] if state[_WINDOW_AGE] > 0.0 else 0.0
        state[_PROVED_LOW] = max(state[_PROVED_LOW], low - unheard)
        state[_PROVED_HIGH] = min(state[_PROVED_HIGH], high + unheard)
        _open_window(state, T, q)
    elif state[_WINDOW_AGE] > _WINDOW:
        _open_window(state, T, q)


@compiled
def _run(
    table: Tables, constants: Array, state: State, time: Array, tension: Array, displacement: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Return the fields of the estimates, shapes (6, n) and (2, n)."""
    n = len(tension)
    values = np.empty((6, n))
    flags = np.empty((2, n), dtype=np.int64)
    for i in range(n):
        dt = time[i] - time[i - 1] if i > 0 else 0.0
        row = _advance(table, constants, state, tension[i], displacement[i], dt)
        values[0, i], values[1, i], values[2, i] = row[0], row[1], row[2]
        values[3, i], values[4, i], values[5, i] = row[3], row[4], row[5]
        flags[0, i], flags[1, i] = row[6], row[7]
    return values, flags
