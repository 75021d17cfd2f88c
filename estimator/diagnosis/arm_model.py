"""Tendons of an arm that are compared with a simulation which knows the motion of all joints.

A tendon is driven by its tension at the housing and by the angles of the joints that it passes,
through the law of `estimator.routing`, with K(t) = K_sheath + sum of mu_j phi_j(theta_j(t)). Two of
its readings are compared: the travel of its motor, R theta + elongation + zero, and the tension in
the arm where it ends, or at the end of its sheath.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np
from scipy.ndimage import minimum_filter1d, uniform_filter1d

from estimator.array_types import Array, Mask
from estimator.compiled import jit_compile
from estimator.diagnosis.record import Record, RecordError, prepare_record
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import DISTAL_DISPLACEMENT, DISTAL_TENSION, PROXIMAL_TENSION, Signals
from estimator.law.sheath import Sheath
from estimator.noise_treatment import apply_play
from estimator.routing.routing import PreparedRouting, Routing, prepare
from estimator.routing.tensions import advance, begin_advance, open_tensions
from estimator.signals.driving_signal import estimate_travel_drive
from estimator.signals.noise import estimate_white_noise

TRAVEL = DISTAL_DISPLACEMENT
"""Name of the motor's travel in a record of a tendon: compared here, it drives nothing."""

SAMPLES_MAX = 1000  # of a tendon that are simulated; a longer record is averaged
TENSION_ACCURACY = 0.003  # of a tension's range, by which the law is off itself
STRETCH_ACCURACY = 0.002  # of the range of the elongation
SLIDING_SHARE = 0.98  # of K, from which on a tendon slides in the whole of its length
SLIDING_SAMPLES_MIN = 50  # of each half of a record, for a tendon to be judged
SLIDING_MARGIN = 4  # samples to either side of what does not, that do not count
MEMORY_MAX = 0.01  # of a tension, that its start may still change where samples count


@dataclass(frozen=True, eq=False)
class ArmData:
    """What was measured on an arm."""

    time: Array  # [s], shape (n,), strictly rising
    proximal_tension: Array  # [N] at the housing, shape (n, tendons); NaN where one is missing
    # [m] of each motor, shape (n, tendons), positive while pulling; None without encoders
    proximal_displacement: Array | None
    distal_tension: Array | None  # [N], shape (n, tendons); None without
    angles: Array  # [rad] of the joints, shape (n, joints)
    is_at_anchor: bool  # `distal_tension` is of tendons' ends in the arm, not of their sheaths'
    has_encoders: bool  # angles were measured, and not computed from travels by the routing
    names: tuple[str, ...]  # of the tendons


class TendonValues(NamedTuple):
    """What is true of one tendon: K, its row of the routing, and its sensors."""

    K: float
    radii: Array  # [m] shape (joints,)
    friction: Array  # mu at the joints, shape (joints,)
    winding: float = 1.0  # 1 as the first tendon of its row, -1 the other way round
    gain: float = 0.0  # of the load cell at the housing, less 1
    bias: float = 0.0  # [N] of it
    distal_gain: float = 0.0
    distal_bias: float = 0.0  # [N]
    encoder_scale: float = 0.0  # less 1
    play: float = 0.0  # [m] between tendon and encoder; negative where the encoder moves first

    def compute_tension(self, reading: Array) -> Array:
        """Return the tension at the housing [N] of readings."""
        return np.maximum((reading - self.bias) / (1.0 + self.gain), 0.0)


class Simulated(NamedTuple):
    """A simulated tendon."""

    signals: Signals
    stiffness: float  # compliance over that of the config, as it fits the travel best


@dataclass(frozen=True, eq=False)
class ArmTendon:
    """One tendon of an arm, ready to be compared: its samples, and all that is known of it."""

    name: str
    record: Record
    angles: Array  # [rad] (n, joints), without noise
    measured_angles: Array  # [rad] (n, joints)
    values: TendonValues  # of the config
    routing: Routing  # of this tendon alone
    sheath: Sheath
    is_at_anchor: bool
    known: dict[str, Mask] = field(default_factory=dict)  # samples that may count
    prepared: dict[bytes, tuple[PreparedRouting, int]] = field(default_factory=dict)  # the newest

    @property
    def has_samples(self) -> bool:
        """Whether enough samples of both halves count."""
        train = self.record.train
        return all(
            min((valid & train).sum(), (valid & ~train).sum()) >= SLIDING_SAMPLES_MIN
            for channel, valid in self.record.valid.items()
            if channel in self.record.compared
        )

    def select_sliding(self, values: TendonValues) -> Self:
        """Return the tendon of which those samples count in which all of it slides."""
        tension = values.compute_tension(self.record.drive)
        slides = find_sliding(
            tension, self.trace(values, tension)[:, 1], self.compute_friction(values)
        )
        valid = {channel: known & slides for channel, known in self.known.items()}
        return replace(self, record=replace(self.record, valid=valid))

    def simulate(self, values: TendonValues, rows: Mask | None = None) -> Simulated:
        """Return what its sensors would have read.

        The travel's zero and how much the tendon stretches, in its sheath and in the arm, are those
        that fit best in `rows`; by default those that are fitted.
        """
        record = self.record
        rows = record.train if rows is None else rows
        tension = values.compute_tension(record.drive)
        trace = self.trace(values, tension)
        signals: Signals = {}
        if DISTAL_TENSION in record.signals:
            T = trace[:, 1 if self.is_at_anchor else 0]
            signals[DISTAL_TENSION] = (1.0 + values.distal_gain) * T + values.distal_bias
        if TRAVEL in record.signals:
            rigid, counted = self.measured_angles @ values.radii, rows & record.valid[TRAVEL]
            half: float = 0.5 * abs(values.play)
            lag: Array = np.zeros(len(tension))
            weights: Array = np.zeros(3)
            stretch = np.column_stack([trace[:, 2:4], np.ones(len(tension))])
            for _ in range(3 if half else 1):
                wanted = record.signals[TRAVEL] / (1.0 + values.encoder_scale) - rigid + lag
                weights = np.asarray(
                    np.linalg.lstsq(stretch[counted], wanted[counted], rcond=None)[0]
                )
                travel = rigid + stretch @ weights
                if half:
                    lag = np.sign(values.play) * (travel - apply_play(travel, half))
            signals[TRAVEL] = (1.0 + values.encoder_scale) * (travel - lag)
            return Simulated(signals, float(weights[0]))
        return Simulated(signals, 1.0)

    def _prepare(self, radii: Array) -> tuple[PreparedRouting, int]:
        """Return the rows of the tendon with some radii [m], and how many are of its sheath."""
        key = radii.tobytes()
        if key not in self.prepared:
            self.prepared.clear()
            is_known = np.array_equal(radii, np.asarray(self.routing.radii)[0])
            routing = self.routing if is_known else _replace_radii(self.routing, radii)
            rows = prepare(routing, [self.sheath], sheath_error=0.0)
            sheath_rows = len(rows.joint) - len(prepare(routing).joint) + 1
            self.prepared[key] = rows, sheath_rows
        return self.prepared[key]

    def compute_friction(self, values: TendonValues) -> Array:
        """Return K of the sheath and of the passed joints, of each sample."""
        routing, theta = self.routing, self.angles
        partner = np.array(routing.partner)
        other = np.where(partner < 0, 0.0, theta[:, partner])
        bend = np.hypot(routing.wrap[0] + routing.side[0] * theta, other)
        return np.asarray(values.K + bend @ values.friction)

    def trace(self, values: TendonValues, tension: Array, *, is_bounded: bool = False) -> Array:
        """Return the columns that `trace_tendon` writes, under a `tension` [N] at the housing."""
        prepared, sheath_rows = self._prepare(values.radii)
        friction = prepared.friction.copy()
        friction[:sheath_rows] *= values.K / self.sheath.K if self.sheath.K else 1.0
        passed = np.asarray(self.routing.friction)[0]
        for j in np.flatnonzero(passed):
            behind = prepared.joint[sheath_rows:] == j
            friction[sheath_rows:][behind] *= values.friction[j] / passed[j]
        out = np.empty((len(tension), 5))
        trace_tendon(
            prepared._replace(friction=friction), sheath_rows, tension, self.angles, is_bounded, out
        )
        return out


def prepare_tendons(
    data: ArmData, routing: Routing, sheaths: Sequence[Sheath], noise: dict[str, float]
) -> list[ArmTendon]:
    """Return the tendons of an arm ready to be compared with a simulation.

    Raises
    ------
    RecordError
        If the data of one cannot be diagnosed; the message names the tendon.
    """
    routing = replace(routing, angle_error=0.0, friction_error=0.0, compliance_error=0.0)
    names = [f"angle {j + 1}" for j in range(routing.joints)]
    rows = group_rows(routing)
    width = -(-len(data.time) // SAMPLES_MAX) | 1  # odd, so that it is centred
    angles = [uniform_filter1d(_fill_gaps(data.time, angle), width) for angle in data.angles.T]
    tendons = []
    for i, name in enumerate(data.names):
        signals = {PROXIMAL_TENSION: data.proximal_tension[:, i]}
        if data.proximal_displacement is not None:
            signals[TRAVEL] = data.proximal_displacement[:, i]
        if data.distal_tension is not None:
            signals[DISTAL_TENSION] = data.distal_tension[:, i]
        try:
            record = prepare_record(
                data.time,
                signals,
                samples_max=SAMPLES_MAX,
                noise=noise,
                loop=False,
                variables=dict(zip(names, angles, strict=True)),
            )
        except RecordError as error:
            raise RecordError(f"tendon {name}: {error}") from error
        first = next(row[0] for row in rows if i in row)
        winding = float(np.sign(np.asarray(routing.radii)[i] @ np.asarray(routing.radii)[first]))
        tendons.append(_build_tendon(data, routing, sheaths[i], (i, winding), record, names))
    return tendons


def group_rows(routing: Routing) -> list[tuple[int, ...]]:
    """Return the tendons of each row of the arm: those that travel alike, or the other way."""
    R = np.asarray(routing.radii)
    rows: list[tuple[int, ...]] = []
    for i, radii in enumerate(R):
        for k, row in enumerate(rows):
            if any(np.allclose(sign * radii, R[row[0]], atol=1e-9) for sign in (1.0, -1.0)):
                rows[k] = (*row, i)
                break
        else:
            rows.append((i,))
    return rows


def _fill_gaps(time: Array, values: Array) -> Array:
    """Return values with those that are missing interpolated."""
    is_known = np.isfinite(values)
    return np.interp(time, time[is_known], values[is_known])


def _build_tendon(
    data: ArmData,
    routing: Routing,
    sheath: Sheath,
    place: tuple[int, float],
    record: Record,
    names: Sequence[str],
) -> ArmTendon:
    i, winding = place
    measured = np.column_stack([record.variables[name] for name in names])
    sigma = [estimate_white_noise(angle, record.time) for angle in measured.T]
    angles = np.column_stack(
        [
            estimate_travel_drive(angle, s, record.time).signal
            for angle, s in zip(measured.T, sigma, strict=True)
        ]
    )
    radii, friction = (np.asarray(table)[i] for table in (routing.radii, routing.friction))
    values = TendonValues(sheath.K, radii, friction, winding)
    tendon = ArmTendon(
        data.names[i], record, angles, measured, values, _select_row(routing, i), sheath,
        data.is_at_anchor,
    )  # fmt: skip
    trace = tendon.trace(values, np.maximum(record.drive, 0.0), is_bounded=True)
    is_known = trace[:, 4] <= MEMORY_MAX * np.maximum(trace[:, 1], 0.1)
    first = int(np.argmax(is_known)) if is_known.any() else 0
    T_noise = record.noise[PROXIMAL_TENSION]
    driven = {
        DISTAL_TENSION: T_noise,
        TRAVEL: float(
            np.hypot(
                np.linalg.norm(radii * sigma), T_noise * sheath.length / sheath.axial_stiffness
            )
        ),
    }
    law = {
        DISTAL_TENSION: TENSION_ACCURACY * np.ptp(record.signals.get(DISTAL_TENSION, trace[:, 1])),
        TRAVEL: STRETCH_ACCURACY * np.ptp(trace[first:, 2]),
    }
    scale = {
        c: float(np.linalg.norm([record.noise[c], driven[c], law[c]])) for c in record.compared
    }
    counts = np.arange(len(record.time)) >= first
    record = replace(
        record,
        valid={channel: valid & counts for channel, valid in record.valid.items()},
        sigma={channel: np.full(len(counts), scale[channel]) for channel in record.compared},
    )
    return replace(tendon, record=record, known=record.valid).select_sliding(values)


def _select_row(routing: Routing, i: int) -> Routing:
    """Return the routing of one tendon, for which nothing is checked: alone it moves no arm."""
    row = copy(routing)
    for name in ("radii", "friction", "wrap", "side", "guide", "span", "length"):
        object.__setattr__(row, name, np.asarray(getattr(routing, name))[i : i + 1])
    object.__setattr__(row, "order", (routing.order[i],))
    return row


def _replace_radii(routing: Routing, radii: Array) -> Routing:
    """Return the routing of one tendon with other radii; where their sign turns, bends do."""
    row, before = copy(routing), np.asarray(routing.radii)[0]
    side = np.where(radii * before > 0.0, np.asarray(routing.side)[0], -np.sign(radii))
    further = tuple(int(j) for j in np.flatnonzero(radii) if j not in routing.order[0])
    for name, value in (("radii", radii[None]), ("side", side[None])):
        object.__setattr__(row, name, value)
    object.__setattr__(row, "order", (tuple(sorted((*routing.order[0], *further))),))
    return row


def find_sliding(proximal: Array, distal: Array, K: Array) -> Mask:
    """Return where all of a tendon slides by its tensions [N], and friction decides, not the past.

    In between, which contacts stick is a matter of noise and of what a tendon gives before.
    """
    ratio = np.log(np.maximum(proximal, 1e-3) / np.maximum(distal, 1e-3))
    is_taut = np.minimum(proximal, distal) > SETTINGS.loose_tension
    slides = is_taut & (np.abs(ratio) >= SLIDING_SHARE * K)
    return np.asarray(minimum_filter1d(slides, 2 * SLIDING_MARGIN + 1))


@jit_compile
def trace_tendon(
    prepared: PreparedRouting,
    sheath_rows: int,
    tension: Array,
    angles: Array,
    is_bounded: bool,
    out: Array,
) -> None:
    """Write the tensions [N] at the end of the sheath and of the tendon, and the elongations [m].

    The fifth column has by how much the tension at the tendon's end may differ with what was
    before the first sample, where `is_bounded`.

    Parameters
    ----------
    prepared : PreparedRouting
        Of one tendon, with `sheath_rows` of its sheath.
    tension : array, shape (n,)
        [N] at the housing.
    angles : array, shape (n, joints)
    out : array, shape (n, 5)
    """
    rows, joints = len(prepared.joint), angles.shape[1]
    tensions, reported = np.empty((3, rows)), np.empty((3, rows))
    state, new_angles = np.empty((2, joints)), np.empty((2, joints))
    sheath_end = np.full((3, 1), tension[0])
    state[0], state[1] = angles[0], angles[0]
    open_tensions(prepared, sheath_end, angles[0], tensions)
    for i in range(len(tension)):
        sheath_end[:] = np.inf  # what is not finite is not advanced
        sheath_end[0, 0] = tension[i]
        if is_bounded:
            sheath_end[1:, 0] = tension[i]
        new_angles[0], new_angles[1] = angles[i], angles[i]
        elements = begin_advance(prepared, tensions, state, new_angles)
        advance(prepared, elements, tensions, state, sheath_end, new_angles, reported)
        out[i, 0], out[i, 1] = tensions[0, sheath_rows - 1], tensions[0, rows - 1]
        stretch = prepared.compliance * tensions[0]
        out[i, 2], out[i, 3] = stretch[:sheath_rows].sum(), stretch[sheath_rows:].sum()
        out[i, 4] = tensions[2, rows - 1] - tensions[1, rows - 1]
