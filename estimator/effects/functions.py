"""Effects with a free function: a quantity of the model follows one variable by a smooth curve.

Where no named cause fits, a penalised B-spline (Eilers, Marx, Stat. Sci. 11, 1996) says on what the
missing part depends and how. The variable's range is part of the effect; outside it the function
stays as at its end. `diagnosis.function_search` fits and judges these effects.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np

from estimator.array_types import Array
from estimator.effects.effect import (
    DISTAL_TENSION,
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Effect,
    EffectContext,
    FunctionTerm,
    Parameter,
    Values,
)
from estimator.effects.sensors import SENSOR_NAMES, build_sensor_effect
from estimator.lumped.lumped_model import Physics
from estimator.online.reading_correction import CURVE_ITERATIONS, CorrectionKind
from estimator.spline import evaluate_spline

COEFFICIENTS = 12
SPEED_COEFFICIENTS = 20  # of two directions: a hump may be a quarter of the highest speed wide
SHRINKAGE = 0.1  # weight of each coefficient over that of their mean
FRICTION_MIN = 0.05  # share of K that a function leaves at least
_REST_SPEED_RATIO = 0.02  # of a high speed, below which the drive rests
_EVERYWHERE = 1e6  # bound of where a variable's range ends

T = TypeVar("T")

# --- variables


class Variable(NamedTuple):
    """What a function may depend on."""

    key: str  # in names of effects
    words: str
    unit: str
    evaluate: Callable[[EffectContext], Array]
    origin: str  # what makes such a dependence
    experiment: str  # that would confirm it
    is_warped: bool = False  # knots are even in the signed square root
    needs_travel: bool = False
    coefficients: int = COEFFICIENTS


def _compute_path(context: EffectContext) -> Array:
    return np.cumsum(np.abs(np.diff(context.drive, prepend=context.drive[0])))


def compute_rest_time(context: EffectContext) -> Array:
    """Return for how long the drive has rested, or rested last before it moved [s], shape (n,)."""
    speed, time = context.speed, context.time
    rests = np.abs(speed) <= _REST_SPEED_RATIO * np.quantile(np.abs(speed), 0.95)
    rested, index = np.concatenate([[True], rests[:-1]]), np.arange(len(time))
    turns = ~rests & ~rested & (np.sign(speed) != np.sign(np.roll(speed, 1)))
    begin = np.maximum.accumulate(np.where(rests & ~rested | turns, index, 0))
    departure = np.maximum.accumulate(np.where(~rests & rested | turns, index, 0))
    return np.asarray(np.where(rests, time, time[departure]) - time[begin])


VARIABLES = (
    Variable(
        "position",
        "motor position",
        "m",
        lambda context: context.drive,
        "a kink, a tight bend, a joint or a worn place that part of the tendon passes",
        "the same swing about another middle position, then with the sheath laid otherwise",
        needs_travel=True,
    ),
    Variable(
        "tension",
        "tension at the housing",
        "N",
        lambda context: context.measured[PROXIMAL_TENSION],
        "a sheath or coating that gives under load, strands that bed in, a cell that is not linear",
        "the same motion at three loads, and known weights on the load cells",
    ),
    Variable(
        "speed",
        "motor speed by direction",
        "m/s",
        lambda context: context.speed,
        "grease, a seal or a one-way wear of strands, which act by speed and direction",
        "the same swing at three speeds, each direction by itself",
        is_warped=True,
        needs_travel=True,
        coefficients=SPEED_COEFFICIENTS,
    ),
    Variable(
        "time",
        "time",
        "s",
        lambda context: context.time - context.time[0],
        "a sheath that is moved, temperature, lubricant that spreads",
        "the same swing every minute, with the sheath fixed and the temperature logged",
    ),
    Variable(
        "path",
        "path length since the start",
        "m",
        _compute_path,
        "running in, wear, lubricant that is carried away",
        "a pause of minutes between two series: time alone must then change nothing",
        needs_travel=True,
    ),
    Variable(
        "rest_time",
        "time at rest before the motion",
        "s",
        compute_rest_time,
        "lubricant squeezed out of contacts, adhesion, a polymer that creeps",
        "rests of 1, 10 and 100 s before the same pull",
        is_warped=True,
    ),
)
_OWN = Variable(
    "reading",
    "its own reading",
    "",
    lambda context: context.time,
    "a sensor that is not linear, or is overloaded at one end",
    "known weights or travels over the whole range of the sensor",
)
_PHASE = Variable(
    "phase",
    "phase of a cycle in time",
    "s",
    lambda context: context.time - context.time[0],
    "something that turns or pulses: a pump, a fan, breathing, a second motor",
    "a record at rest, then one at another motor speed: does the period stay?",
)


def build_column_variable(name: str) -> Variable:
    """Return the variable that a further column of the data is."""
    return Variable(
        name,
        name.replace("_", " "),
        "",
        lambda context: context.variables.get(name, np.zeros_like(context.time)),
        f"what {name.replace('_', ' ')} acts on, such as a lubricant or a cell",
        f"the same swing at three values of {name.replace('_', ' ')}",
    )


# --- the function and its penalty


def _warp(x: Array) -> Array:
    return np.asarray(np.sign(x) * np.sqrt(np.abs(x)))


def _compute_share(term: FunctionTerm, values: Values, x: Array) -> Array:
    """Return where values of the variable are in the function's range, 0 to 1."""
    if term.is_periodic:
        return np.asarray(x / values[0] % 1.0)
    low, high = values[:2]
    if term.is_warped:
        x, (low, high) = _warp(x), _warp(np.array([low, high]))
    return np.clip((x - low) / max(high - low, 1e-12), 0.0, 1.0)


def split_values(effect: Effect, values: tuple[T, ...]) -> tuple[tuple[T, ...], tuple[T, ...]]:
    """Return the ends of the range or the period of an effect's function, and its coefficients."""
    count = 1 if effect.function is not None and effect.function.is_periodic else 2
    return values[:count], values[count:]


def evaluate_function(effect: Effect, values: Values, x: Array) -> Array:
    """Return the function of an effect at values of its variable, shape (n,)."""
    term = effect.function
    if term is None:
        raise ValueError(f"{effect.name}: has no free function")
    c = np.array(split_values(effect, values)[1])
    share = _compute_share(term, values, np.asarray(x, dtype=np.float64))
    return evaluate_spline(np.concatenate([c, c[:3]]) if term.is_periodic else c, share)


def _evaluate_in(effect: Effect, values: Values, context: EffectContext) -> Array:
    """Return the function of an effect in a record, shape (n,)."""
    if effect.function is None:
        raise ValueError(f"{effect.name}: has no free function")
    return evaluate_function(effect, values, effect.function.evaluate(context))


def compute_basis(effect: Effect, values: Values, x: Array) -> Array:
    """Return the derivatives of the function by its coefficients, shape (n, coefficients)."""
    shapes, coefficients = split_values(effect, values)
    unit_rows = (tuple(row) for row in np.eye(len(coefficients)).tolist())
    return np.column_stack([evaluate_function(effect, (*shapes, *row), x) for row in unit_rows])


def compute_penalty(values: Values, effect: Effect, roughness: float, mean: float) -> Array:
    """Return the rows that keep a function smooth and its mean at zero, for least squares.

    Second differences leave a straight line free, whose end goes far where few samples are: so each
    coefficient is shrunk, too (Marra, Wood, Comput. Stat. Data Anal. 55, 2011).

    Parameters
    ----------
    roughness, mean : float
        Weights of the second differences and of the mean, in residuals per step.
    """
    term = effect.function
    if term is None:
        return np.empty(0)
    c = np.array(split_values(effect, values)[1]) / effect.parameters[-1].step
    ends = np.concatenate([c[-1:], c, c[:1]]) if term.is_periodic else c
    return np.concatenate(
        [roughness * np.diff(ends, 2), [mean * float(c.mean())], SHRINKAGE * mean * c]
    )


def penalise(effect: Effect, roughness: float, mean: float, degrees: float | None) -> Effect:
    """Return an effect penalised by `compute_penalty` with these weights, which leave `degrees`."""
    return replace(
        effect,
        penalty=partial(compute_penalty, effect=effect, roughness=roughness, mean=mean),
        penalised_degrees=degrees,
    )


# --- targets


class _Target(NamedTuple):
    """What is changed by a function."""

    key: str
    words: str
    coefficient: Parameter
    equation: str
    is_share: bool
    channel: str = ""  # of a reading
    has_zero: bool = True  # whether the law takes up a constant


_SHARE = Parameter("c", "", -0.95, 5.0, 0.05)
_LENGTH = Parameter("c", "m", -0.02, 0.02, 1e-5)
_FORCE = Parameter("c", "N", -20.0, 20.0, 0.05)

_CORRECTIONS = {
    PROXIMAL_TENSION: CorrectionKind.TENSION_CURVE,
    PROXIMAL_DISPLACEMENT: CorrectionKind.DISPLACEMENT_CURVE,
}

_TARGETS = (
    _Target("friction", "friction", _SHARE, "K (1 + f)", True),
    _Target("elongation", "elongation", _LENGTH, "e + f", False),
    _Target("tip_load", "where the load at the tip rests", _LENGTH, "zero + f", False),
    *(
        _Target(
            channel,
            f"the reading of {words}",
            _LENGTH if channel.endswith("displacement") else _FORCE,
            "reading + f",
            False,
            channel,
            has_zero=channel.endswith("displacement"),
        )
        for channel, words in SENSOR_NAMES.items()
    ),
    *(
        _Target(
            f"{channel}_gain",
            f"the gain of {SENSOR_NAMES[channel]}",
            _SHARE._replace(step=0.02),
            "reading (1 + f)",
            True,
            channel,
        )
        for channel in (PROXIMAL_TENSION, DISTAL_TENSION)
    ),
)


def _change_physics(
    physics: Physics, values: Values, context: EffectContext, *, effect: Effect
) -> Physics:
    f = _evaluate_in(effect, values, context)
    if effect.name.startswith("friction"):
        return physics._replace(friction=physics.friction * (1.0 + f).clip(FRICTION_MIN))
    if effect.name.startswith("elongation"):
        return physics._replace(stretch=physics.stretch + f)
    return physics._replace(tip_offset=physics.tip_offset + f)


def _change_reading(
    signal: Array,
    values: Values,
    context: EffectContext,
    *,
    effect: Effect,
    direction: int,
) -> Array:
    if effect.name.endswith("_by_reading"):
        f = evaluate_function(effect, values, signal)
        for _ in range(CURVE_ITERATIONS - 1 if direction < 0 else 0):  # f is of the true signal
            f = evaluate_function(effect, values, signal - f)
    else:
        f = _evaluate_in(effect, values, context)
    if effect.function is not None and effect.function.is_share:
        return np.asarray(signal * (1.0 + f).clip(FRICTION_MIN) ** direction)
    return np.asarray(signal + direction * f)


def _build_function(target: _Target, x: Variable) -> Effect:
    """Return the effect by which a target depends on a variable."""
    is_periodic, unit = x is _PHASE, x.unit
    if x is _OWN:
        unit = target.coefficient.unit
    evaluate = (lambda context: context.measured[target.channel]) if x is _OWN else x.evaluate
    term = FunctionTerm(
        target.words,
        x.words,
        unit,
        evaluate,
        is_share=target.is_share,
        is_warped=x.is_warped,
        is_periodic=is_periodic,
        has_zero=target.has_zero,
    )
    shapes = (
        (Parameter("period", "s", 0.05, _EVERYWHERE, 0.01, None),)
        if is_periodic
        else tuple(
            Parameter(end, unit, -_EVERYWHERE, _EVERYWHERE, 1.0, None, is_fixed=True)
            for end in ("from", "to")
        )
    )
    coefficients = tuple(
        target.coefficient._replace(name=f"c{k}") for k in range(1, x.coefficients + 1)
    )
    effect = Effect(
        name=f"{target.key}_by_{x.key}",
        cause=f"{target.words} depends on {x.words}",
        equation=f"{target.equation}, f a cubic B-spline of {x.words} with {x.coefficients} "
        "coefficients",
        parameters=(*shapes, *coefficients),
        source="no law: a penalised spline, Eilers and Marx 1996",
        advice=f"Possible origin: {x.origin}. Experiment that decides: {x.experiment}.",
        starts=lambda _: [],
        required_channels=frozenset({PROXIMAL_DISPLACEMENT} if x.needs_travel else ()),
        function=term,
        correction=_CORRECTIONS.get(target.key) if x is _OWN else None,
    )
    if x.key == "position" or (x is _OWN and target.channel == PROXIMAL_DISPLACEMENT):
        effect = replace(effect, shift_encoder_zero=_shift_range)
    if not target.channel:
        return replace(effect, physics=partial(_change_physics, effect=effect))
    forward = partial(_change_reading, effect=effect, direction=1)
    backward = partial(_change_reading, effect=effect, direction=-1)
    return build_sensor_effect(target.channel, forward, backward, effect)


def _shift_range(values: Values, zero: float) -> Values:
    return (values[0] + zero, values[1] + zero, *values[2:])


def build_functions(columns: Iterable[str] = ()) -> tuple[Effect, ...]:
    """Return all effects with a function, of further columns too."""
    variables = (*VARIABLES, _PHASE, *map(build_column_variable, columns))
    return tuple(
        _build_function(target, x)
        for target in _TARGETS
        for x in (*variables, *([_OWN] if target.channel and not target.is_share else []))
        # a reading that depends on itself as measured would follow anything
        if (target.channel, x.key) != (PROXIMAL_TENSION, "tension")
    )


def find_column(name: str) -> str:
    """Return the further column on which the effect of a name depends; "" for none."""
    column = name.partition("_by_")[2]
    return "" if column in (x.key for x in (*VARIABLES, _PHASE, _OWN)) else column


def find_function(name: str) -> Effect | None:
    """Return the effect of a name such as `friction_by_position`; None if there is none."""
    functions = build_functions(filter(None, [find_column(name)]))
    return next((effect for effect in functions if effect.name == name), None)


FUNCTIONS = build_functions()
"""Without those of further columns."""


FRICTION_BY_TIME = next(effect for effect in FUNCTIONS if effect.name == "friction_by_time")
