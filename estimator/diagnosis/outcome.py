"""What a diagnosis says."""

from collections.abc import Iterable, Sequence
from enum import StrEnum
from itertools import zip_longest
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.dataset import Dataset, Fit, Model, SimulatedRecord
from estimator.diagnosis.record import UNIT_SCALE, BenchScale, Record
from estimator.diagnosis.residual_structure import ResidualDependence
from estimator.diagnosis.scoring import Choice, SimpleFit, SimpleGain
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import (
    DISTAL_DISPLACEMENT,
    DISTAL_TENSION,
    PROXIMAL_DISPLACEMENT,
    Effect,
    Values,
)
from estimator.fitting import IntervalEstimate
from estimator.online.extended_model import keeps_mean
from estimator.signals.sampling import DataIssue
from estimator.units import Units


class ErrorStatistics(NamedTuple):
    """Errors of a model in one channel, on one set of samples."""

    rmse: float  # in the channel's unit
    largest: float  # share of full scale
    mean: float  # share of full scale


class PredictedRecord(NamedTuple):
    """A record that was not fitted, as both models predict it."""

    record: Record
    before: SimulatedRecord  # by the base law
    after: SimulatedRecord  # by the extended law

    def fitness(self, simulated: SimulatedRecord) -> dict[str, ErrorStatistics]:
        """Return the errors of one of the two predictions, by channel."""
        return {
            channel: compute_error_statistics(
                [self.residual(simulated, channel)], float(np.ptp(self.record.signals[channel]))
            )
            for channel in self.record.compared
        }

    def residual(self, simulated: SimulatedRecord, channel: str) -> Array:
        """Return measured less simulated of the samples that count [N] or [m]."""
        valid = self.record.valid[channel]
        return (self.record.signals[channel] - simulated.signals[channel])[valid]

    @property
    def spikes(self) -> dict[str, int]:
        """Single-sample spikes that were excluded, by channel."""
        excluded = dict.fromkeys(self.record.signals, 0)
        for issue in self.record.issues:
            if issue.what == SPIKES:
                excluded[issue.channel] = issue.samples
        return excluded


SPIKES = "single-sample spikes"


def compute_error_statistics(residuals: Sequence[Array], full_scale: float) -> ErrorStatistics:
    """Return the errors of some residuals, in shares of a full scale [N] or [m]."""
    error = np.concatenate(residuals)
    share = np.abs(error) / max(full_scale, 1e-12)
    return ErrorStatistics(
        float(np.sqrt(np.mean(error**2))), float(share.max()), float(share.mean())
    )


class ForceError(NamedTuple):
    """How far the estimated force is off what the load cell at the tip reads."""

    rmse: float  # [N]
    mean: float  # [N]
    largest: float  # [N]
    full_scale: float  # [N] largest reading
    samples: int
    spikes: int  # single-sample spikes of that cell, excluded


class FileForce(NamedTuple):
    """The force in one record, estimated with both models."""

    validation: bool  # not fitted
    before: ForceError
    after: ForceError


LIVE_ERROR_RATIO_MAX = 1.05  # times the live error without a model, above which it is worse


class LiveError(NamedTuple):
    """RMSE of the force that the loop estimates on samples that were not fitted [N]."""

    without: float
    extended: float

    @property
    def is_worse(self) -> bool:
        """Whether the extended model is of no use in the loop."""
        return self.extended > LIVE_ERROR_RATIO_MAX * self.without

    def describe(self) -> str:
        """Return both errors in words."""
        return (
            f"on data not fitted the force estimated live is off by {self.extended:.3g} N with "
            f"this model, by {self.without:.3g} N without"
        )


class RivalForce(NamedTuple):
    """What another cause in the model would do to the estimated force."""

    replaces: str
    label: str
    mean: float  # [N] mean of the absolute difference
    largest: float  # [N]
    full_scale: float  # [N] largest force estimated with the cause itself


class Verdict(StrEnum):
    """How a diagnosis ends."""

    CLEAN = "clean"  # nothing wrong beyond noise
    NAMED = "named"  # one cause, or one after another
    AMBIGUOUS = "ambiguous"  # one of several that these channels cannot tell apart
    CHARACTERISED = "characterised"  # no cause, but a function of one variable explains it
    UNEXPLAINED = "unexplained"  # the model is wrong, and nothing in the catalogue explains it


class FittedValue(NamedTuple):
    """A fitted value with its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str
    at_bound: bool = False  # the value is as far as the parameter may go: it may be further


class ModelErrors(NamedTuple):
    """Errors on fitted, held-out and validation samples, by channel."""

    fit: dict[str, ErrorStatistics]
    held_out: dict[str, ErrorStatistics]
    validation: dict[str, ErrorStatistics]  # empty without records of its own


class RankedCandidate(NamedTuple):
    """A candidate cause and its score."""

    effect: Effect  # the best of its variants
    score: float  # log-likelihood ratio of held-out data with it to without, less BIC penalty
    rmse: dict[str, float]  # held out, by channel
    residual_fraction: float  # share of the error beyond noise that it leaves
    values: Values  # of its parameters

    @property
    def name(self) -> str:
        """Return the effect's name."""
        return self.effect.name

    @property
    def label(self) -> str:
        """Return the effect's name and variant."""
        return self.effect.label


class CauseStep(NamedTuple):
    """One cause found on top of those before it."""

    effect: Effect
    rivals: tuple[str, ...]  # names that these channels do not tell from it
    ranking: tuple[RankedCandidate, ...]
    fit: Fit  # all causes so far, fitted to all samples


def decide_verdict(
    steps: Sequence[CauseStep],
    residual_fraction: float,
    *,
    is_noise_before: bool,
    is_noise_after: bool,
    is_drifting: bool,
) -> Verdict:
    """Return how a diagnosis ends.

    Parameters
    ----------
    steps : sequence of CauseStep
        The causes that were named, one after another.
    residual_fraction : float
        The held-out error with them, over that without.
    is_noise_before, is_noise_after : bool
        Whether the base law alone, or the law with the causes, leaves no more than noise.
    is_drifting : bool
        Whether the causes leave friction that drifts.
    """
    if not steps:
        return Verdict.CLEAN if is_noise_before else Verdict.UNEXPLAINED
    is_large = residual_fraction > SETTINGS.unexplained_fraction_max
    if is_drifting or (is_large and not is_noise_after):
        return Verdict.UNEXPLAINED
    if steps[-1].effect.function is not None:
        return Verdict.CHARACTERISED
    return Verdict.AMBIGUOUS if any(step.rivals for step in steps) else Verdict.NAMED


class Rival(NamedTuple):
    """A model with another effect in the place of a cause, fitted to all samples."""

    replaces: str  # name of that cause
    effect: Effect
    fit: Fit


class Curve(NamedTuple):
    """The free function of an extended model over the range of its variable."""

    effect: Effect
    x: Array  # of the variable, shape (m,)
    value: Array  # beside its median, shape (m,): a share, or in the unit of what it changes
    half_width: Array  # of the 95 % interval, shape (m,)
    unit: str  # of the values
    period: float  # [s] of a cycle that the variable is the phase of, else 0


class DetectionLimit(NamedTuple):
    """The smallest size at which an effect would have been seen."""

    parameter: str
    size: float
    unit: str


class Diagnosis(NamedTuple):
    """What is wrong with the model of a dataset, why, and the gain of correcting it.

    All numbers are in the units of the records.
    """

    verdict: Verdict
    steps: tuple[CauseStep, ...]
    ranking: tuple[RankedCandidate, ...]  # of the first search
    parameters: dict[str, FittedValue]
    dataset: Dataset
    baseline: Fit  # the plain law, fitted to all samples
    extended: Fit  # the baseline again where nothing was found
    before: ModelErrors
    after: ModelErrors
    gain: dict[str, IntervalEstimate]
    noise: dict[str, float]
    residual_fraction: float  # of the error beyond noise, what the extended model leaves
    has_drifting_friction: bool  # friction changes with time, and not as the causes say
    foreign_reason: str  # why the data are of no tendon in a sheath; empty if they may be
    laws: Choice  # of the base law
    loads: Choice  # of what the tips of several files pull at
    simple_models: tuple[SimpleFit, ...]  # that know no sheath, fitted to the same data
    simple_gain: dict[str, SimpleGain]  # of the extended law over the best of them, by channel
    learned_models: tuple[SimpleFit, ...]  # empty without scikit-learn, and where all is fitted
    learned_gain: dict[str, SimpleGain]  # of the best of them over the extended law, by channel
    residual_dependences: tuple[ResidualDependence, ...]  # of what the extended model leaves
    detection_limits: dict[str, DetectionLimit]  # by effect; of a clean dataset
    experiments: tuple[str, ...]  # that would settle what is ambiguous
    issues: tuple[DataIssue, ...]
    fit_all: bool = False  # no sample was held out: all errors are of fitted samples
    rivals: tuple[Rival, ...] = ()  # models with one of the equally good causes
    validation: tuple[PredictedRecord, ...] = ()  # records that were not fitted
    left_out: tuple[PredictedRecord, ...] = ()  # each record, by the fit of the others
    forces: tuple[FileForce, ...] = ()  # error of the force that the loop would estimate
    live_error: LiveError | None = None  # None without a cell at the tip, or a model
    rival_forces: tuple[RivalForce, ...] = ()  # what each rival would do to that force
    scale: BenchScale = UNIT_SCALE  # of the bench, at which it was made
    curve: Curve | None = None  # of a model with a free function
    untried: tuple[str, ...] = ()  # searches for which the time limit left none

    @property
    def units(self) -> Units:
        """Units of the records."""
        return self.dataset.records[0].units

    @property
    def has_idle_function(self) -> bool:
        """Whether no loop follows its only effect, and the mean of that estimates no better live.

        The mean of friction need not be the best constant K.
        """
        effects = [effect for effect, _ in self.extended.model.effects]
        error = self.live_error
        is_mean = len(effects) == 1 and keeps_mean(effects[0])
        return is_mean and error is not None and error.without <= error.extended

    @property
    def live_model(self) -> Model:
        """The model for the loop: the plain law with its own K in the place of an idle function."""
        return (self.baseline if self.has_idle_function else self.extended).model

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the effects, in the order found."""
        return tuple(step.effect.name for step in self.steps)

    @property
    def duration(self) -> float:
        """Of the longest record [s]."""
        return max(float(record.time[-1]) for record in self.dataset.records)

    @property
    def ambiguous_with(self) -> tuple[str, ...]:
        """Names that cannot be told from one of the causes."""
        names = [name for step in self.steps for name in step.rivals]
        return tuple(dict.fromkeys(name for name in names if name not in self.causes))


# --- what to measure next, so that causes which look alike in the channels at hand come apart


WEIGHTS = "hang the same known weight on both load cells"
TARE = "tare both load cells while the tendon is slack"
STRAIGHT_SHEATH = "one run with the sheath laid straight: friction goes, errors of sensors stay"
SEVERAL_SPEEDS = "the same swing at three speeds or more, down to creeping"
NESTED_SWINGS = "swings of several depths, nested in one another"
TENSION_HOLDS = "holds of 10 s or more at two tensions"
REPEATED_SWING = "the same swing at the beginning and at the end"
HARD_STOP = "a return to a hard stop now and then"
KNOWN_TRAVEL = "a known travel, measured beside the encoders"
PULLEY_TURNS = "two turns of the pulley or more"
BLOCKED_TIP = "a run with the tip blocked"
TEMPERATURE_LOG = "a log of the temperature"
TIP_CELL = "a load cell at the tip"
TIP_ENCODER = "an encoder at the tip"
MOTOR_TRAVEL = "the motor's travel"

ISOLATED_EFFECTS: dict[str, frozenset[str]] = {
    WEIGHTS: frozenset({"proximal_tension_gain", "distal_tension_gain"}),
    TARE: frozenset({"proximal_tension_bias", "distal_tension_bias"}),
    STRAIGHT_SHEATH: frozenset(
        {
            "friction_step",
            "friction_drift",
            "constant_drag",
            "stribeck_friction",
            "presliding",
            "distributed_play",
            "direction_asymmetry",
            "tension_dependent_friction",
            "nonuniform_curvature",
            "stick_slip",
        }
    ),
    SEVERAL_SPEEDS: frozenset(
        {"viscous_friction", "stribeck_friction", "sensor_lag", "tip_inertia", "stick_slip"}
    ),
    NESTED_SWINGS: frozenset(
        {
            "presliding",
            "distributed_play",
            "tension_dependent_friction",
            "joint_backlash",
            "sheath_rub",
        }
    ),
    TENSION_HOLDS: frozenset({"creep"}),
    REPEATED_SWING: frozenset(
        {
            "friction_step",
            "friction_drift",
            "proximal_tension_drift",
            "distal_tension_drift",
            "pretension",
            "tip_moved",
        }
    ),
    HARD_STOP: frozenset({"encoder_slip", "thermal_expansion", "creep"}),
    KNOWN_TRAVEL: frozenset({"encoder_scale"}),
    PULLEY_TURNS: frozenset({"pulley_eccentricity", "cogging_ripple"}),
    BLOCKED_TIP: frozenset(
        {
            "joint_friction",
            "joint_backlash",
            "antagonist_tension",
            "tip_contact",
            "tip_inertia",
            "tip_moved",
        }
    ),
    TEMPERATURE_LOG: frozenset(
        {"thermal_expansion", "proximal_tension_drift", "distal_tension_drift", "friction_drift"}
    ),
}
"""Which effects an experiment singles out."""

EXPERIMENTS_MAX = 3  # beside one for a channel that was not measured

SEPARATING_EXPERIMENTS = frozenset({WEIGHTS, TARE})
"""Experiments that tell the effects they single out from one another, too."""

_CHANNELS = {
    DISTAL_TENSION: TIP_CELL,
    PROXIMAL_DISPLACEMENT: MOTOR_TRAVEL,
    DISTAL_DISPLACEMENT: TIP_ENCODER,
}


def suggest_experiments(sets: Iterable[Iterable[str]], channels: Iterable[str]) -> tuple[str, ...]:
    """Return experiments that tell effects apart which look alike, for each of some sets of them.

    First those that leave least together, then channels that were not measured.
    """
    useful = [_select_useful_experiments(frozenset(names)) for names in sets]
    interleaved = [
        experiment for turn in zip_longest(*useful) for experiment in turn if experiment is not None
    ]
    experiments = list(dict.fromkeys(interleaved))[:EXPERIMENTS_MAX]
    missing = [text for channel, text in _CHANNELS.items() if channel not in set(channels)]
    return tuple([*experiments, *missing][: EXPERIMENTS_MAX + 1]) if experiments else ()


def _select_useful_experiments(effects: frozenset[str]) -> list[str]:
    """Return the experiments that tell some of the effects apart, the best first."""
    unresolved = {
        experiment: _count_unresolved(experiment, effects) for experiment in ISOLATED_EFFECTS
    }
    useful = [experiment for experiment, count in unresolved.items() if count < len(effects)]
    return sorted(useful, key=lambda experiment: unresolved[experiment])


def _count_unresolved(experiment: str, effects: frozenset[str]) -> int:
    """Return how many of the effects an experiment leaves together, at worst."""
    isolated = effects & ISOLATED_EFFECTS[experiment]
    indistinct = min(len(isolated), 1) if experiment in SEPARATING_EXPERIMENTS else len(isolated)
    return max(indistinct, len(effects - isolated))
