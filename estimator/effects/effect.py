"""What an effect is: something that real transmissions do and the paper's model does not.

An effect changes what is simulated in one of three places, and is neutral where it says nothing:

* `physics` changes the tendon, its sheath or what holds the tip (`lumped_model.Physics`);
* `measure` is what its sensor makes of the true signals;
* `invert` takes that away again from the signal that drives the simulation, `correction` from one
  sample of the housing's readings at a time (estimator.online.reading_correction).

Several effects act one after another, in the order in which they are given.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np

from estimator.array_types import Array, Mask
from estimator.lumped.lumped_model import Physics
from estimator.online.reading_correction import CorrectionKind

T = TypeVar("T")
Values = tuple[float, ...]

PROXIMAL_TENSION, PROXIMAL_DISPLACEMENT = "proximal_tension", "proximal_displacement"
DISTAL_TENSION, DISTAL_DISPLACEMENT = "distal_tension", "distal_displacement"
CHANNELS = (PROXIMAL_TENSION, PROXIMAL_DISPLACEMENT, DISTAL_TENSION, DISTAL_DISPLACEMENT)

Signals = dict[str, Array]
"""By channel, [N] and [m], shape (n,) each."""


class Parameter(NamedTuple):
    """One number of an effect."""

    name: str
    unit: str
    low: float
    high: float
    step: float
    """A change that matters; fits count in it."""
    neutral: float | None = 0.0
    """Its value without the effect; None where it only shapes the effect."""
    jumps: bool = False
    """Whether it must be searched step by step, since it has no gradient."""
    is_fixed: bool = False
    """Whether a fit leaves it as it is."""


class EffectContext(NamedTuple):
    """What is known of a record where an effect begins to be looked for."""

    time: Array  # [s]
    driver: str  # the channel that drives the simulation
    drive: Array  # it, fit to drive: [m] or [N]
    speed: Array  # of it [m/s] or [N/s]
    measured: Signals
    simulated: Signals  # by the model without the effect
    compliance: Array  # dq_p/dT_in [m/N] of that model
    elongation_per_newton: float  # L/EA [m/N] of that model
    newton: float = 1.0  # of the records, in the unit of force here (diagnosis.record)
    radian: float = 1.0  # of records of torque and angle, in the unit of travel here
    present: Mapping[str, Mask] = MappingProxyType({})  # the others are interpolated
    variables: Mapping[str, Array] = MappingProxyType({})  # further columns, shape (n,) each
    file: int = 0  # number of the record among those fitted, from 1; 0 = none of them

    @property
    def peak(self) -> float:
        """Largest tension measured at the housing [N]."""
        return float(self.measured[PROXIMAL_TENSION].max())

    def select_measured(self, channel: str) -> Mask:
        """Return which samples of a channel were measured, shape (n,)."""
        return self.present.get(channel, np.ones(len(self.time), dtype=np.bool_))

    def spread_times(self, count: int) -> list[float]:
        """Return times [s] spread over the record, its very ends left out."""
        shares = (np.arange(count) + 0.5) / count
        return [float(t) for t in self.time[0] + shares * (self.time[-1] - self.time[0])]


class FunctionTerm(NamedTuple):
    """A free function of one variable in an effect (effects.functions)."""

    target: str  # what it changes, in words
    variable: str  # what it depends on, in words
    unit: str  # of the variable
    evaluate: Callable[[EffectContext], Array]  # the variable in a record, (n,)
    is_share: bool  # its values are shares of what it changes
    is_warped: bool  # knots are even in the signed square root of the variable
    is_periodic: bool
    has_zero: bool  # the law takes up a constant


def _keep(unchanged: T, *_: object) -> T:
    return unchanged


def _keep_free(_values: Values) -> Array:
    return np.empty(0)


@dataclass(frozen=True)
class Effect:
    """One way in which a transmission differs from the paper's model.

    Attributes
    ----------
    name
        In files, reports and on the command line; variants of one cause share it.
    where
        Which variant, in words; empty where there is one only.
    cause
        What goes on, in a sentence that can follow "because".
    equation
        What it adds to the model.
    parameters
        Fitted with those of the model.
    source
        Where equation and range come from.
    advice
        What a person does who has it on their bench.
    starts
        Values to begin fits from; where it decides the local minimum, several.
    required_channels
        Channels without which the effect is not defined.
    limit_parameters
        Given the parameters, the motor's span [m] in a record and values of a fit, returns the
        parameters with the bounds that such a span can resolve.
    correction
        Of a sensor at the housing: how its readings are put right one by one, in another session
        too; None where they cannot be.
    shift_encoder_zero
        Given values and `zero` [m], returns the values for readings of the motor's encoder that are
        higher by `zero`.
    is_transient
        Whether it shows only in short intervals, such as the first samples of a motion, which a
        subsampled record does not contain.
    function
        What it changes by a free function, and of what; None for an effect with a law.
    penalty
        Rows of least squares that keep its values plausible, in residuals.
    penalised_degrees
        Degrees of freedom that the penalty leaves; None where all parameters are free.
    file
        The only fitted record that it acts in, from 1; 0 where it acts in all.
    """

    name: str
    cause: str
    equation: str
    parameters: tuple[Parameter, ...]
    source: str
    advice: str
    starts: Callable[[EffectContext], Iterable[Values]]
    physics: Callable[[Physics, Values, EffectContext], Physics] = _keep
    measure: Callable[[Signals, Values, EffectContext], Signals] = _keep
    invert: Callable[[Array, Values, EffectContext], Array] = _keep
    where: str = ""
    required_channels: frozenset[str] = frozenset()
    limit_parameters: Callable[[tuple[Parameter, ...], float, Values], tuple[Parameter, ...]] = (
        _keep
    )
    correction: CorrectionKind | None = None
    shift_encoder_zero: Callable[[Values, float], Values] = _keep
    is_transient: bool = False
    function: FunctionTerm | None = None
    penalty: Callable[[Values], Array] = _keep_free
    penalised_degrees: float | None = None
    file: int = 0

    @property
    def label(self) -> str:
        """Name, variant and file."""
        where = ", ".join(filter(None, (self.where, f"in file {self.file}" * (self.file > 0))))
        return f"{self.name} ({where})" if where else self.name

    @property
    def degrees(self) -> float:
        """Degrees of freedom of a fit."""
        return len(self.parameters) if self.penalised_degrees is None else self.penalised_degrees

    def is_active_in(self, context: EffectContext) -> bool:
        """Return whether it acts in a record."""
        return self.file in (0, context.file)


def set_physics(*names: str) -> Callable[[Physics, Values, EffectContext], Physics]:
    """Return a change of the tendon that sets fields of `Physics` to an effect's values in turn."""

    def physics(physics: Physics, values: Values, _context: EffectContext) -> Physics:
        fields: dict[str, Any] = dict(zip(names, values, strict=True))
        return physics._replace(**fields)

    return physics


def compute_step(time: Array, onset: float, duration: float = 0.0) -> Array:
    """Return 0 before `onset` [s] and 1 after, shape (n,), the step taken `duration` so long [s].

    No shorter than from one sample to the next, which one in between would be in anyway.
    """
    duration = max(duration, float(np.median(np.diff(time))))
    return np.clip((time - onset) / duration + 0.5, 0.0, 1.0)


def transform_channel(signals: Signals, channel: str, change: Callable[[Array], Array]) -> Signals:
    """Return signals with one of them changed, if it is there."""
    if channel not in signals:
        return signals
    return {**signals, channel: change(signals[channel])}
