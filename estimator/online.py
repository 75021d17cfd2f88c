"""The online estimator of one tendon: from what the housing measures to what the tip feels.

`step` is pure: prepared model, state, one sample and its dt go in; an estimate and the next state
come out. `run` does the same to a whole record with the same compiled kernel, so live operation,
replay and tests give the same numbers.

Three parts: estimator.memory says what is remembered, estimator.driver decides which end drives,
estimator.proof keeps the interval that motion has proved.

The interval does not rest on the decision who drives. It is (T2), widened by the sensor noise and
cut by what motion has proved; it always holds the estimate.

A model with an extension (estimator.extension) has its readings put right before, and what its
effects add to the law (estimator.beyond) put on top.
"""

import math
from dataclasses import dataclass, field
from enum import IntFlag
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator import beyond, signals
from estimator import tables as _tables
from estimator.compiled import compiled
from estimator.driver import anchor, follow
from estimator.extension import Extension, corrected
from estimator.memory import (
    BAND,
    BESIDE,
    BOUND,
    CONSTANTS,
    DISPLACEMENT_FLOOR,
    DRIVER,
    E_ERROR,
    HELD,
    HIGH,
    JOINED,
    K_ERROR,
    LOW,
    MEAN_Q,
    MEAN_T,
    MEMORY,
    PLACE,
    PROVED_HIGH,
    PROVED_LOW,
    RATE,
    SCALARS,
    SIGMA_Q,
    SIGMA_T,
    STARTED,
    T_LEAST,
    T_MOST,
    TAU,
    TENSION_FLOOR,
    VARIANCE,
    Array,
    State,
)
from estimator.profile import (
    log_tension,
    pretensioned_profile,
    push_proximal,
    tension_of,
)
from estimator.proof import open_window, prove
from estimator.sheath import Sheath
from estimator.tables import Tables, tables
from estimator.transmission import Phase, read_out, tension_at

NEGATIVE = 0.05
"""Zero offset [N] that is not a broken load cell."""

LARGEST = 1e6
"""Tension [N] that is no tendon's."""


class ModelError(ValueError):
    """A tendon model that cannot be; the message names the field, the value and what is allowed."""


class Status(IntFlag):
    """What stands against an estimate; 0 is a plain one.

    TENSION_ONLY: no displacement, so the motor is taken to drive and the interval is (T2).
    UNINITIALISED: T_in has not swung by e^2K since the start, so the initial profile is assumed.
    TIP_MOVED: the sliding direction says that the tip drives. SLACK: no tension within the noise.
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
    extension
        What a diagnosis found beyond the law of the sheath, if anything.
    """

    sheath: Sheath
    tension_noise: float = 0.0  # [N]
    displacement_noise: float = 0.0  # [m]
    initial: Literal["slack"] | float = "slack"  # [N]
    treatment: signals.Treatment = field(default_factory=signals.Treatment)
    friction_error: float = 0.02
    elongation_error: float = 0.1
    tip_tension_rate: float = 100.0  # [N/s]
    extension: Extension | None = None

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
    extension: Extension | None = None


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
    constants = np.empty(CONSTANTS)
    constants[SIGMA_T] = model.tension_noise
    constants[SIGMA_Q] = max(model.displacement_noise, DISPLACEMENT_FLOOR)
    constants[TAU] = model.treatment.time_constant if model.tension_noise > 0.0 else 0.0
    constants[BAND] = model.treatment.dead_band
    constants[K_ERROR] = model.friction_error
    constants[E_ERROR] = model.elongation_error
    constants[RATE] = model.tip_tension_rate
    scalars = np.zeros(SCALARS)
    scalars[T_LEAST] = math.inf
    scalars[PROVED_HIGH] = math.inf
    scalars[HIGH] = math.inf
    parts = [scalars, profile, profile]
    if model.extension is not None:
        beside, readings = model.extension
        parts.append(beyond.start(beside) if len(beside) else beside)
        parts.append(np.full(len(readings), math.nan))
    return Prepared(table, constants, np.concatenate(parts), model.extension)


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
    table, constants, _, extension = prepared
    T, q = proximal_tension, proximal_displacement
    if extension is None:
        row = _advance(table, constants, after, T, q, dt)
    else:
        beside, readings = extension
        if readings:
            T, q = corrected(readings, after[-len(readings) :], T, q)
        row = _extended(table, constants, beside, after, T, q, dt)
    return TendonEstimate(*row[:6], _PHASES[row[6]], _STATUSES[row[7]]), after


def right(
    prepared: Prepared, state: State, proximal_tension: float, proximal_displacement: float
) -> tuple[float, float]:
    """Return what `step` takes a sample for: T_in [N] and q_p [m] without the sensors' effects.

    The same as given for a model without such effects; `state` is left as it was.
    """
    extension = prepared.extension
    if extension is None or not extension.readings:
        return proximal_tension, proximal_displacement
    memory = state[-len(extension.readings) :].copy()
    return corrected(extension.readings, memory, proximal_tension, proximal_displacement)


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
    time, T, q = (np.ascontiguousarray(row, dtype=np.float64) for row in (time, tension, q))
    state, extension = prepared.initial.copy(), prepared.extension
    if extension is not None and extension.readings:
        T, q = _all_corrected(extension, state, T, q)
    beside = np.empty(0) if extension is None else extension.constants
    values, flags = _run(prepared.tables, prepared.constants, beside, state, time, T, q)
    return Estimates(*values, *flags)


def profile_at(prepared: Prepared, state: State, x: Array) -> Array:
    """Return the tension T(x) [N] the state remembers at the arc lengths `x` [m], shape (n,)."""
    return tension_at(prepared.tables, state[SCALARS:MEMORY], np.asarray(x, dtype=np.float64))


def _all_corrected(
    extension: Extension, state: State, tension: Array, displacement: Array
) -> tuple[Array, Array]:
    """Return tension [N] and travel [m] of a record as they are."""
    memory = state[-len(extension.readings) :]
    rows = zip(tension.tolist(), displacement.tolist(), strict=True)
    right = [corrected(extension.readings, memory, T, q) for T, q in rows]
    return np.array([T for T, _ in right]), np.array([q for _, q in right])


_PHASES = tuple(Phase)
_STATUSES = tuple(Status(value) for value in range(32))

_TENSION_ONLY = int(Status.TENSION_ONLY)
_UNINITIALISED = int(Status.UNINITIALISED)
_TIP_MOVED = int(Status.TIP_MOVED)
_SLACK = int(Status.SLACK)
_INVALID = int(Status.INVALID_INPUT)
_PULL, _RELEASE = int(Phase.PULL), int(Phase.RELEASE)

_K, _EA, _ASYMMETRY = _tables.K, _tables.EA, _tables.ASYMMETRY


@compiled
def _advance(
    table: Tables, constants: Array, state: State, T: float, q: float, dt: float
) -> tuple[float, float, float, float, float, float, int, int]:
    """Take one sample, in place; return the fields of a `TendonEstimate`."""
    profile = state[SCALARS:MEMORY]
    unheard = constants[RATE] * dt if dt > 0.0 else 0.0
    state[PROVED_LOW] -= unheard
    state[PROVED_HIGH] += unheard
    sigma = constants[SIGMA_T]
    if (
        not math.isfinite(T)
        or math.isinf(q)
        or not (0.0 <= dt < math.inf)
        or T + NEGATIVE + 6.0 * sigma < 0.0
        or T > LARGEST
    ):
        status = _INVALID | (0 if _erased(table, state) else _UNINITIALISED)
        state[JOINED] = 0.0
        state[LOW] = max(state[LOW] - unheard, 0.0)
        state[HIGH] += unheard
        _, T_out, e, phase, front = read_out(table, profile)
        return T_out, state[LOW], state[HIGH], e, math.nan, front, phase, status

    status = 0
    tau = constants[TAU]
    if state[STARTED] == 0.0:
        state[STARTED] = 1.0
        state[MEAN_T] = state[HELD] = T
        state[VARIANCE] = sigma * sigma
    mean = signals.average(state[MEAN_T], T, dt, tau)
    # what was proved of T_out ages by what the motor itself may have changed since
    fall = state[MEAN_T] - mean
    by_release = math.exp(table[_ASYMMETRY] * table[_K])
    state[PROVED_LOW] -= max(fall, 0.0) * by_release
    state[PROVED_HIGH] += max(-fall, 0.0)
    state[VARIANCE] = signals.averaged_variance(state[VARIANCE], sigma, dt, tau)
    sigma_mean = math.sqrt(state[VARIANCE])
    band = constants[BAND] * sigma_mean
    held = signals.play(state[HELD], mean, band)
    state[MEAN_T] = mean
    slack = mean <= 3.0 * max(sigma_mean, TENSION_FLOOR)
    if slack:
        held = 0.0
        status |= _SLACK
    state[T_LEAST] = min(state[T_LEAST], held)
    state[T_MOST] = max(state[T_MOST], held)

    if math.isnan(q):
        status |= _TENSION_ONLY
        state[JOINED] = 0.0
        state[DRIVER] = 0.0
        state[PROVED_LOW], state[PROVED_HIGH] = 0.0, math.inf
        state[HELD] = held
        push_proximal(table, profile, held)
    else:
        fresh = state[JOINED] == 0.0 or slack
        mean_q = q if fresh else signals.average(state[MEAN_Q], q, dt, tau)
        if fresh:
            push_proximal(table, profile, held)
            state[HELD], state[MEAN_Q], state[PLACE] = held, mean_q, mean_q
            state[DRIVER], state[JOINED] = 0.0, 1.0
            anchor(table, state, held, mean_q)
            open_window(state, mean, mean_q)
        else:
            sure_T = band + BOUND * (sigma_mean + TENSION_FLOOR)
            follow(table, constants, state, held, mean_q, sure_T, dt)
            prove(table, constants, state, mean, mean_q, sigma_mean, dt)
        if state[DRIVER] != 0.0:
            status |= _TIP_MOVED
    if not _erased(table, state):
        status |= _UNINITIALISED

    margin = BOUND * sigma
    K = table[_K] * (1.0 + constants[K_ERROR])
    low = tension_of(table, log_tension(table, min(mean, T, held) - margin) - K)
    high = tension_of(
        table, log_tension(table, max(mean, T, held) + margin) + table[_ASYMMETRY] * K
    )
    if state[PROVED_LOW] > state[PROVED_HIGH]:
        state[PROVED_LOW], state[PROVED_HIGH] = 0.0, math.inf
    # the average lags: so much the tip may be ahead of what was proved by it
    proved_low = state[PROVED_LOW] - max(mean - T, 0.0) * by_release
    proved_high = state[PROVED_HIGH] + max(T - mean, 0.0)
    if max(low, proved_low) <= min(high, proved_high):
        low, high = max(low, proved_low), min(high, proved_high)
    _, T_out, e, phase, front = read_out(table, profile)
    low, high = min(low, T_out), max(high, T_out)
    state[LOW], state[HIGH] = low, high
    return T_out, low, high, e, q - e, front, phase, status


@compiled
def _extended(
    table: Tables, constants: Array, beside: Array, state: State, T: float, q: float, dt: float
) -> tuple[float, float, float, float, float, float, int, int]:
    """Take one sample with what effects add to the law; in place, as `_advance`."""
    if len(beside) == 0:
        return _advance(table, constants, state[:BESIDE], T, q, dt)
    more = state[BESIDE : BESIDE + beyond.STATE]
    # who drives is decided by the travel that the law knows
    row = _advance(table, constants, state[:BESIDE], T, q - more[beyond.TRAVEL], dt)
    T_out, low, high, e, q_d, front, phase, status = row
    if status & _INVALID == 0:
        beyond.push(beside, more, state[HELD], q, dt)
        q_d = q - (e + more[beyond.ELONGATION])
    elif 0.0 <= dt < math.inf:
        more[beyond.UNHEARD] += dt
    change = more[beyond.TENSION]
    most = max(state[T_MOST], T_out)  # no tip that is only pulled at pulls harder than that
    felt = min(max(T_out + change, 0.0), most)
    low = min(max(min(low, low + change), 0.0), felt)
    high = max(high, min(high + change, most), felt)
    return (
        felt, low, high, e + more[beyond.ELONGATION], q_d, front, phase, status,
    )  # fmt: skip


@compiled
def _erased(table: Tables, state: State) -> bool:
    """Return whether T_in has swung so far since the start that the first profile is forgotten."""
    swing = math.exp((1.0 + table[_ASYMMETRY]) * table[_K])
    drag = table[_tables.DRAG]
    least = max(state[T_LEAST], TENSION_FLOOR)
    erased: bool = state[T_MOST] + drag >= swing * (least + drag)
    return erased


@compiled
def _run(
    table: Tables,
    constants: Array,
    beside: Array,
    state: State,
    time: Array,
    tension: Array,
    displacement: Array,
) -> tuple[Array, NDArray[np.int64]]:
    """Return the fields of the estimates, shapes (6, n) and (2, n)."""
    n = len(tension)
    values = np.empty((6, n))
    flags = np.empty((2, n), dtype=np.int64)
    for i in range(n):
        dt = time[i] - time[i - 1] if i > 0 else 0.0
        row = _extended(table, constants, beside, state, tension[i], displacement[i], dt)
        values[0, i], values[1, i], values[2, i] = row[0], row[1], row[2]
        values[3, i], values[4, i], values[5, i] = row[3], row[4], row[5]
        flags[0, i], flags[1, i] = row[6], row[7]
    return values, flags
