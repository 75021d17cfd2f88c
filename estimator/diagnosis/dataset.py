"""Records of one bench, the model that simulates them, and its residual."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from functools import lru_cache
from threading import Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.record import (
    Record,
    mark_all_as_train,
    select_record_rows,
    select_subsample,
)
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import (
    DISTAL_DISPLACEMENT,
    DISTAL_TENSION,
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Effect,
    EffectContext,
    Parameter,
    Signals,
    Values,
)
from estimator.lumped.loop_model import simulate_loop
from estimator.lumped.lumped_model import Motion, Physics, simulate_by_tension, simulate_by_travel
from estimator.lumped.nodes import build_even_weights

# --- base laws of a transmission: how friction goes with the load
# * capstan: dT/ds = -/+ T, s from 0 to K; contacts of a tendon are rigid, those of a loop's cables
#   have a presliding width;
# * load-independent: dT/ds = -/+ F, s from 0 to 1, F the friction of the whole sheath [N]; contacts
#   give elastically before they slide, over the presliding width (Dahl 1968);
# * both: dT/ds = -/+ (T + F/K), with a presliding width.


FRICTION = Parameter("K", "", 0.01, 5.0, 0.05)
FRICTION_FORCE = Parameter("friction", "N", 1e-3, 200.0, 0.05)  # of a whole sheath, at any load
PRESLIDING_WIDTH = Parameter("presliding width", "m", 1e-7, 5e-3, 5e-6, None)

_LOAD_INDEPENDENT_K = 1e-3  # K of friction that no load changes: to within 0.1 % of the load


class BaseLaw(StrEnum):
    """Base laws."""

    CAPSTAN = "capstan"
    INDEPENDENT = "load-independent"
    BOTH = "capstan and load-independent"


_PARAMETERS: Mapping[BaseLaw, tuple[Parameter, ...]] = {
    BaseLaw.CAPSTAN: (FRICTION,),
    BaseLaw.INDEPENDENT: (FRICTION_FORCE, PRESLIDING_WIDTH),
    BaseLaw.BOTH: (FRICTION, FRICTION_FORCE, PRESLIDING_WIDTH),
}


def list_law_parameters(law: BaseLaw, loop: bool) -> tuple[Parameter, ...]:
    """Return the parameters of a law, before those of elasticity and load."""
    return (FRICTION, PRESLIDING_WIDTH) if loop and law is BaseLaw.CAPSTAN else _PARAMETERS[law]


EXCLUDED_EFFECTS: Mapping[BaseLaw, frozenset[str]] = {
    BaseLaw.CAPSTAN: frozenset(),
    BaseLaw.INDEPENDENT: frozenset({"constant_drag", "presliding", "tension_dependent_friction"}),
    BaseLaw.BOTH: frozenset({"constant_drag", "presliding"}),
}
"""Effects that a law has in it already, or that are defined on another only."""


def apply_base_law(physics: Physics, law: BaseLaw, values: Mapping[str, float]) -> Physics:
    """Return a tendon with the friction of a law; `values` by name of `list_law_parameters`."""
    ones, width = np.ones_like(physics.friction), values.get(PRESLIDING_WIDTH.name, 0.0)
    if law is BaseLaw.CAPSTAN:
        return physics._replace(friction=values[FRICTION.name] * ones, presliding=width)
    K = _LOAD_INDEPENDENT_K if law is BaseLaw.INDEPENDENT else values[FRICTION.name]
    return physics._replace(
        friction=K * ones, drag=values[FRICTION_FORCE.name] / K, presliding=width
    )


COMPLIANCE = Parameter("L/EA", "m/N", 1e-7, 2e-2, 5e-6)
TIP_COMPLIANCE = Parameter("tip compliance", "m/N", 0.0, 0.1, 1e-5)
PRETENSION = Parameter("pretension", "N", 0.1, 500.0, 0.2)  # of a closed loop
# of each record, about the first reading of its encoder
TAUT_TRAVEL = Parameter("taut at", "m", -10.0, 10.0, 1e-5)
TIP_ZERO = Parameter("tip zero", "m", -10.0, 10.0, 1e-6)
TIP_MASS = Parameter("tip mass", "kg", 0.0, 50.0, 0.02)


class LoadModel(StrEnum):
    """What several records have in common of what their tips pull at."""

    SHARED = "the same load in all files"
    SPRINGS = "a spring in each file"
    MASSES = "a spring and a mass in each file"


OWN_LOADS = {
    LoadModel.SHARED: (),
    LoadModel.SPRINGS: (TIP_COMPLIANCE,),
    LoadModel.MASSES: (TIP_COMPLIANCE, TIP_MASS),
}


class BaseParameters(NamedTuple):
    """Parameters that every model has: of the dataset, and of each record."""

    shared: tuple[Parameter, ...]
    own: tuple[Parameter, ...]
    law: BaseLaw = BaseLaw.CAPSTAN
    loads: LoadModel = LoadModel.SHARED

    def values(self, shared: Sequence[float], own: Sequence[float]) -> dict[str, float]:
        """Return the values of a record's model by name of their parameter."""
        names = (p.name for p in (*self.shared, *self.own))
        return dict(zip(names, (*shared, *own), strict=True))

    def compliance(self, shared: Sequence[float]) -> float | None:
        """Return L/EA [m/N]; None where the channels do not tell it."""
        return self.values(shared, [0.0] * len(self.own)).get(COMPLIANCE.name)


class SimulatedRecord(NamedTuple):
    """One record, simulated."""

    signals: Signals  # what the sensors would have read, by channel
    motion: Motion  # what they would have read it of


COARSE_RATIO_MIN = 2.0  # samples of a record for one that is simulated: else all of them are


class CoarseSteps(NamedTuple):
    """A simulation of some of a record's samples that stands for one of all of them.

    What the motion of one model is beside its own coarse simulation is added to that of any other
    (additive correction of a low-fidelity model, Alexandrov et al., J. Aircraft 38, 2001). At that
    model nothing is lost, near it hardly anything.
    """

    rows: NDArray[np.intp]  # of the samples that are simulated, shape (m,)
    left: NDArray[np.intp]  # the one of them at or before each sample, shape (n,)
    weight: Array  # of the next one, shape (n,)
    correction: Array  # of what `Motion` has, shape (5, n)

    def refine(self, motion: Motion) -> Motion:
        """Return the motion in all samples of one in `rows`."""
        coarse = np.array(motion)
        step = np.diff(coarse, axis=1, append=coarse[:, -1:])
        return Motion(*(coarse[:, self.left] + self.weight * step[:, self.left] + self.correction))


def build_base_parameters(
    record: Record, law: BaseLaw = BaseLaw.CAPSTAN, loads: LoadModel = LoadModel.SHARED
) -> BaseParameters:
    """Return the parameters that the channels of a record call for."""
    is_travel_driven = record.driver != PROXIMAL_TENSION
    has_tip_travel = DISTAL_DISPLACEMENT in record.signals
    shared = [*list_law_parameters(law, record.loop), *([COMPLIANCE] if is_travel_driven else [])]
    has_load = is_travel_driven or has_tip_travel
    own = [*([TAUT_TRAVEL] if is_travel_driven else []), *([TIP_ZERO] if has_tip_travel else [])]
    if has_load and loads is LoadModel.SHARED:
        shared.append(TIP_COMPLIANCE)
    elif has_load:
        own += OWN_LOADS[loads]
    if record.loop:
        shared.append(PRETENSION)
    return BaseParameters(tuple(shared), tuple(own), law, loads)


def find_record_zeros(record: Record, base: BaseParameters) -> list[float]:
    """Return what a record's own parameters count from: the first readings of its encoders."""
    zeros = {TAUT_TRAVEL: float(record.drive[0])}
    if TIP_ZERO in base.own:
        zeros[TIP_ZERO] = float(record.signals[DISTAL_DISPLACEMENT][0])
    return [zeros.get(p, 0.0) for p in base.own]


def compute_record_bounds(record: Record, base: BaseParameters) -> list[tuple[float, float]]:
    """Return between which values a record's own parameters may be, in the order of its base."""
    zeros = find_record_zeros(record, base)
    bounds = [(zero + p.low, zero + p.high) for zero, p in zip(zeros, base.own, strict=True)]
    if TAUT_TRAVEL in base.own and record.starts_slack:
        T = record.signals[PROXIMAL_TENSION]
        compliance = float(np.ptp(record.drive)) / float(np.ptp(T))
        margin = SETTINGS.slack_noise * record.noise[PROXIMAL_TENSION] * compliance
        bounds[0] = (float(record.drive[0]) - margin, float(record.drive[0]) + margin)
    return bounds


class _WorkClock:
    """How many samples all threads of the process have simulated."""

    def __init__(self) -> None:
        self._lock = Lock()
        self.samples = 0

    def add(self, samples: int) -> None:
        """Count a simulation."""
        with self._lock:
            self.samples += samples


_WORK = _WorkClock()
LOOP_WORK = 3  # samples of a tendon, in the time of one of a loop
SAMPLES_PER_SECOND = 3e5  # that a search simulates, beside its other work (studies/results)


def read_work_clock() -> float:
    """Return for how long the process has simulated [s], by samples: the same on any machine."""
    return _WORK.samples / SAMPLES_PER_SECOND


def simulate_record(
    record: Record,
    context: EffectContext,
    base: BaseParameters,
    shared: Sequence[float],
    own: Sequence[float],
    effects: Sequence[tuple[Effect, Values]],
    coarse: CoarseSteps | None = None,
) -> SimulatedRecord:
    """Return what the sensors of a record would have read.

    Parameters
    ----------
    context : EffectContext
        What effects may know of it.
    shared, own : sequence of float
        Their values.
    effects : sequence of (Effect, values)
        On top, in this order.
    coarse : CoarseSteps, optional
        Simulate some of the samples only.
    """
    samples = len(record.time if coarse is None else coarse.rows)
    _WORK.add(LOOP_WORK * samples if record.loop else samples)
    values = base.values(shared, own)
    effects = [pair for pair in effects if pair[0].is_active_in(context)]
    physics = build_plain_physics(record, base, values)
    for effect, numbers in effects:
        physics = effect.physics(physics, numbers, context)
    drive = invert_effects(record.drive, context, effects)
    motion = (
        _simulate_motion(_Drive(record, physics, drive, values))
        if coarse is None
        else coarse.refine(_simulate_rows(record, physics, drive, values, coarse.rows))
    )
    signals: Signals = {
        PROXIMAL_TENSION: motion.proximal_tension,
        PROXIMAL_DISPLACEMENT: motion.proximal_displacement,
        DISTAL_TENSION: motion.distal_tension,
    }
    if TIP_ZERO in base.own:
        signals[DISTAL_DISPLACEMENT] = motion.distal_displacement + values[TIP_ZERO.name]
    for effect, numbers in effects:
        signals = effect.measure(signals, numbers, context)
    return SimulatedRecord({name: signals[name] for name in record.compared}, motion)


def invert_effects(
    drive: Array, context: EffectContext, effects: Sequence[tuple[Effect, Values]]
) -> Array:
    """Return what a reading of the driver is of, without what the effects have made of it."""
    for effect, numbers in reversed(effects):
        drive = effect.invert(drive, numbers, context)
    return drive


def build_plain_physics(
    record: Record, base: BaseParameters, values: Mapping[str, float]
) -> Physics:
    """Return the tendon of a record, or each cable of its loop, without effects."""
    physics = Physics(
        np.ones(len(record.time)),
        values.get(COMPLIANCE.name, SETTINGS.assumed_compliance),
        build_even_weights(),
        values.get(TIP_COMPLIANCE.name, 0.0),
        mass=values.get(TIP_MASS.name, 0.0),
    )
    return apply_base_law(physics, base.law, values)


MOTIONS_KEPT = 24  # simulations that are not repeated for other readings of the same motion


class _Drive:
    """All that a motion follows from, to be compared by its values."""

    def __init__(
        self, record: Record, physics: Physics, drive: Array, values: Mapping[str, float]
    ) -> None:
        self.record, self.physics, self.drive = record, physics, drive
        self.start = values.get(TAUT_TRAVEL.name, 0.0), values.get(PRETENSION.name, 0.0)
        parts = (record.time, record.speed, drive, *physics, *self.start)
        self._key = (
            record.loop,
            record.driver,
            *(part.tobytes() if isinstance(part, np.ndarray) else part for part in parts),
        )

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Drive) and self._key == other._key


@lru_cache(maxsize=MOTIONS_KEPT)
def _simulate_motion(driven: _Drive) -> Motion:
    """Return what the ends of the transmission do when it is driven; its arrays are shared."""
    record, physics, (taut_travel, pretension) = driven.record, driven.physics, driven.start
    travel = driven.drive - taut_travel
    if record.loop:
        motion = simulate_loop(physics, pretension, record.time, travel, record.speed)
    elif record.driver == PROXIMAL_TENSION:
        tension = np.maximum(driven.drive, 0.0)
        motion = simulate_by_tension(physics, record.time, tension, record.speed)
    else:
        motion = simulate_by_travel(physics, record.time, travel, record.speed)
    for signal in motion:
        signal.flags.writeable = False
    return motion


def _simulate_rows(
    record: Record,
    physics: Physics,
    drive: Array,
    values: Mapping[str, float],
    rows: NDArray[np.intp],
) -> Motion:
    """Return what the ends do in some of the samples."""
    by_sample = {
        name: part[rows]
        for name, part in physics._asdict().items()
        if np.shape(part) == record.time.shape
    }
    physics = physics._replace(**by_sample)
    few = replace(
        record, time=record.time[rows], drive=record.drive[rows], speed=record.speed[rows]
    )
    return _simulate_motion(_Drive(few, physics, drive[rows], values))


def build_context(
    record: Record, simulated: SimulatedRecord | None, compliance: float
) -> EffectContext:
    """Return what effects may know of a record, with the model without them where there is one."""
    no_signals: Mapping[str, Array] = {}
    return EffectContext(
        record.time,
        record.driver,
        record.drive,
        record.speed,
        record.signals,
        dict(no_signals if simulated is None else simulated.signals),
        np.zeros_like(record.time) if simulated is None else simulated.motion.compliance,
        compliance,
        1.0 / record.scale.force,
        1.0 / record.scale.travel,
        record.present,
        record.variables,
        record.file,
    )


# --- records of one bench, and their simulation by a model


class Dataset(NamedTuple):
    """Records of one dataset, which share its physics."""

    records: tuple[Record, ...]
    base: BaseParameters
    scale: tuple[dict[str, Array], ...]  # of the residuals, by record and channel


class Model(NamedTuple):
    """A model with its numbers."""

    shared: Values  # of the dataset
    own: tuple[Values, ...]  # of each record
    effects: tuple[tuple[Effect, Values], ...]


class Fit(NamedTuple):
    """A fitted model, and what it makes of each record."""

    model: Model
    simulated: tuple[SimulatedRecord, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its effects."""
        return tuple(effect.name for effect, _ in self.model.effects)


class TautEstimate(NamedTuple):
    """Where a record that starts slack is expected to be taut [m], and how surely."""

    travel: float
    uncertainty: float


def build_dataset(
    records: Sequence[Record], law: BaseLaw = BaseLaw.CAPSTAN, loads: LoadModel = LoadModel.SHARED
) -> Dataset:
    """Return a dataset whose residuals are scaled by the noise, or a small share of the range.

    What is not fitted yet is wrong in all channels; one that is measured very finely must not
    decide alone then.
    """
    scale = tuple(
        {
            channel: np.maximum(sigma, SETTINGS.scale_min * float(np.ptp(record.signals[channel])))
            for channel, sigma in record.sigma.items()
        }
        for record in records
    )
    return Dataset(tuple(records), build_base_parameters(records[0], law, loads), scale)


def replace_records(dataset: Dataset, records: Sequence[Record]) -> Dataset:
    """Return a dataset of other records with the same base law and loads."""
    return build_dataset(records, dataset.base.law, dataset.base.loads)


def use_all_samples(dataset: Dataset) -> Dataset:
    """Return a dataset of which all samples are fitted."""
    return dataset._replace(records=tuple(map(mark_all_as_train, dataset.records)))


def subsample(dataset: Dataset, samples_max: int) -> Dataset:
    """Return a dataset of about `samples_max` samples a record, for a first look."""
    row_masks = [select_subsample(record, samples_max) for record in dataset.records]
    return dataset._replace(
        records=tuple(
            select_record_rows(*pair) for pair in zip(dataset.records, row_masks, strict=True)
        ),
        scale=tuple(
            {channel: values[rows] for channel, values in scale.items()}
            for scale, rows in zip(dataset.scale, row_masks, strict=True)
        ),
    )


def compute_mean_noise(dataset: Dataset) -> dict[str, float]:
    """Return the expected rms error of each channel by noise, in its unit."""
    return {
        channel: math.sqrt(float(np.mean(variance)))
        for channel, variance in _collect_variances(dataset).items()
    }


def compute_tolerance(dataset: Dataset) -> dict[str, float]:
    """Return the tolerated rms error of each channel, relative to `Record.sigma`.

    By noise, and by the `Settings.accuracy` of a simulation.
    """
    tolerances = {}
    for channel, variance in _collect_variances(dataset).items():
        range_max = max(float(np.ptp(record.signals[channel])) for record in dataset.records)
        error_bound = SETTINGS.accuracy * range_max
        tolerances[channel] = math.sqrt(1.0 + float(np.mean(error_bound**2 / variance)))
    return tolerances


def _collect_variances(dataset: Dataset) -> dict[str, Array]:
    return {
        channel: np.concatenate(
            [record.sigma[channel][record.valid[channel]] ** 2 for record in dataset.records]
        )
        for channel in dataset.records[0].compared
    }


def rescale_residuals(dataset: Dataset, fit: Fit) -> Dataset:
    """Return a dataset whose residuals are scaled by noise and a share of the fit's residual."""
    scale = []
    for record, simulated in zip(dataset.records, fit.simulated, strict=True):
        record_scale = {}
        for channel in record.compared:
            error = (simulated.signals[channel] - record.signals[channel])[record.valid[channel]]
            residual_part = SETTINGS.residual_share * float(error.std())
            record_scale[channel] = np.hypot(record.sigma[channel], residual_part)
        scale.append(record_scale)
    return dataset._replace(scale=tuple(scale))


def build_contexts(dataset: Dataset, fit: Fit) -> tuple[EffectContext, ...]:
    """Return what effects may know of each record beside a model without them."""
    compliance = dataset.base.compliance(fit.model.shared) or 0.0
    return tuple(
        build_context(record, simulated, compliance)
        for record, simulated in zip(dataset.records, fit.simulated, strict=True)
    )


def build_unsimulated_contexts(dataset: Dataset, fit: Fit) -> tuple[EffectContext, ...]:
    """Return what effects may know of records that have not been simulated yet."""
    compliance = dataset.base.compliance(fit.model.shared) or 0.0
    return tuple(build_context(record, None, compliance) for record in dataset.records)


def simulate_dataset(
    dataset: Dataset,
    contexts: Sequence[EffectContext],
    model: Model,
    coarse: Sequence[CoarseSteps | None] = (),
) -> Fit:
    """Return a model with what it makes of each record; `coarse` steps of each, or none at all."""
    simulated = tuple(
        simulate_record(record, context, dataset.base, model.shared, own, model.effects, steps)
        for record, context, own, steps in zip(
            dataset.records, contexts, model.own, coarse or [None] * len(model.own), strict=True
        )
    )
    return Fit(model, simulated)


def build_coarse_steps(
    dataset: Dataset, contexts: Sequence[EffectContext], fit: Fit, samples_max: int
) -> tuple[CoarseSteps | None, ...]:
    """Return coarse steps of each record about a fit, None where there are hardly fewer."""
    steps: list[CoarseSteps | None] = []
    for record, context, own, simulated in zip(
        dataset.records, contexts, fit.model.own, fit.simulated, strict=True
    ):
        is_kept, n = select_subsample(record, samples_max), len(record.time)
        is_kept[-1] = True
        rows = np.flatnonzero(is_kept)
        if COARSE_RATIO_MIN * len(rows) > n:
            steps.append(None)
            continue
        left = np.cumsum(is_kept) - 1
        time, after = record.time[rows], np.minimum(left + 1, len(rows) - 1)
        weight = (record.time - time[left]) / np.where(after > left, time[after] - time[left], 1.0)
        uncorrected = CoarseSteps(rows, left, weight, np.zeros((len(Motion._fields), n)))
        model = fit.model
        motion = simulate_record(
            record, context, dataset.base, model.shared, own, model.effects, uncorrected
        ).motion
        steps.append(uncorrected._replace(correction=np.array(simulated.motion) - np.array(motion)))
    return tuple(steps)


def compute_residual(dataset: Dataset, fit: Fit) -> Array:
    """Return what is fitted: simulated less measured where it counts, and what is expected."""
    parts = []
    for record, simulated, scale, own in zip(
        dataset.records, fit.simulated, dataset.scale, fit.model.own, strict=True
    ):
        for channel in record.compared:
            is_counted = record.train & record.valid[channel]
            error = simulated.signals[channel] - record.signals[channel]
            parts.append((error / scale[channel])[is_counted])
        expected = estimate_taut_travel(record, dataset.base, fit.model)
        if expected is not None:
            parts.append(np.array([(own[0] - expected.travel) / expected.uncertainty]))
    parts += [effect.penalty(values) for effect, values in fit.model.effects]
    return np.concatenate(parts)


def compute_cost(dataset: Dataset, fit: Fit) -> float:
    """Return what a fit makes as small as it can."""
    return float(np.sum(compute_residual(dataset, fit) ** 2))


def estimate_taut_travel(record: Record, base: BaseParameters, model: Model) -> TautEstimate | None:
    """Return where the motor must be for the first tension that was read, in a slack start."""
    compliance = base.compliance(model.shared)
    if compliance is None or not record.starts_slack:
        return None
    sigma = record.noise[PROXIMAL_TENSION]
    drive, tensions = record.first_tensions
    return TautEstimate(
        drive - compliance * max(0.0, float(tensions.mean())),
        max(SETTINGS.taut_sigma * compliance * sigma, SETTINGS.taut_sigma_min),
    )
