"""Records in the units of their bench, and what a diagnosis says in those of its records."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

from estimator.diagnosis.bench_scale import UNSCALED, BenchScale, scale_of
from estimator.diagnosis.dataset import Dataset, Fit, Model
from estimator.diagnosis.law_choice import Choice
from estimator.diagnosis.model import TAUT, Base, Simulated
from estimator.diagnosis.outcome import Diagnosis, Fitnesses, Number, Ranked
from estimator.diagnosis.prediction import Fitness, Predicted
from estimator.diagnosis.record import Record, efforts_of
from estimator.diagnosis.simple_models import SimpleFit
from estimator.effects.effect import (
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Effect,
    Parameter,
    Values,
)

Errors = dict[str, float]


def bench_scale(records: Sequence[Record]) -> BenchScale:
    """Return the scale of the bench that records are of."""
    efforts = [effort for record in records for effort in efforts_of(record.signals)]
    travels = [record.drive for record in records if record.driver != PROXIMAL_TENSION]
    if not travels and records[0].units.rotary:
        travels = [
            signal
            for record in records
            for name, signal in record.signals.items()
            if name.endswith("displacement")
        ]
    return scale_of(efforts, travels)


def in_bench_units(record: Record, scale: BenchScale) -> Record:
    """Return a record in the units of its bench."""
    return _converted(record, scale, scale)


def in_record_units(found: Diagnosis, scale: BenchScale) -> Diagnosis:
    """Return a diagnosis in the units of its records, made in those of their bench."""
    units, base = found.units, found.dataset.base

    def fit(one: Fit) -> Fit:
        return _fit(one, base, scale)

    return found._replace(
        scale=scale,
        steps=tuple(
            step._replace(ranking=_ranking(step.ranking, scale), fit=fit(step.fit))
            for step in found.steps
        ),
        ranking=_ranking(found.ranking, scale),
        parameters=_numbers(found, scale),
        dataset=_dataset(found.dataset, scale),
        baseline=fit(found.baseline),
        extended=fit(found.extended),
        before=_fitnesses(found.before, scale),
        after=_fitnesses(found.after, scale),
        noise=_errors(found.noise, scale),
        laws=_choice(found.laws, scale),
        loads=_choice(found.loads, scale),
        simple_models=tuple(_simple(one, scale) for one in found.simple_models),
        detection_limits={
            name: one._replace(size=one.size * scale.size(one.unit), unit=units.name(one.unit))
            for name, one in found.detection_limits.items()
        },
        rivals=tuple(one._replace(fit=fit(one.fit)) for one in found.rivals),
        validation=tuple(_predicted(one, scale) for one in found.validation),
        left_out=tuple(_predicted(one, scale) for one in found.left_out),
    )


def _converted(record: Record, by: BenchScale, scale: BenchScale) -> Record:
    """Return a record counted in the units of `by`, whose scale is then another."""
    signals = {name: signal / by.size_of(name) for name, signal in record.signals.items()}
    unit = by.size_of(record.driver)
    zero = by.zero if record.driver == PROXIMAL_DISPLACEMENT else 0.0
    if zero:
        signals[record.driver] = (record.signals[record.driver] - zero) / unit
    return replace(
        record,
        signals=signals,
        drive=(record.drive - zero) / unit,
        speed=record.speed / unit,
        noise={name: sigma / by.size_of(name) for name, sigma in record.noise.items()},
        sigma={name: sigma / by.size_of(name) for name, sigma in record.sigma.items()},
        scale=scale,
    )


def _out(record: Record, scale: BenchScale) -> Record:
    return _converted(record, scale.inverse, UNSCALED)


def _dataset(dataset: Dataset, scale: BenchScale) -> Dataset:
    return dataset._replace(
        records=tuple(_out(record, scale) for record in dataset.records),
        scale=tuple(
            {name: scale.size_of(name) * sigma for name, sigma in each.items()}
            for each in dataset.scale
        ),
    )


def _fit(fit: Fit, base: Base, scale: BenchScale) -> Fit:
    model = fit.model
    return Fit(
        Model(
            _values(base.shared, model.shared, scale),
            tuple(_own(base, own, scale) for own in model.own),
            tuple((effect, _of_effect(effect, values, scale)) for effect, values in model.effects),
        ),
        tuple(_simulated(one, scale) for one in fit.simulated),
    )


def _values(parameters: Sequence[Parameter], values: Values, scale: BenchScale) -> Values:
    return tuple(scale.size(p.unit) * value for p, value in zip(parameters, values, strict=True))


def _own(base: Base, own: Values, scale: BenchScale) -> Values:
    zeros = (scale.zero if p == TAUT else 0.0 for p in base.own)
    return tuple(a + b for a, b in zip(_values(base.own, own, scale), zeros, strict=True))


def _of_effect(effect: Effect, values: Values, scale: BenchScale) -> Values:
    return effect.from_zero(_values(effect.parameters, values, scale), scale.zero)


def _simulated(one: Simulated, scale: BenchScale) -> Simulated:
    """Return what was simulated; the motion's travel counts from the slack tendon on anyway."""
    signals = {name: scale.size_of(name) * signal for name, signal in one.signals.items()}
    sizes = map(scale.size, ("N", "N", "m", "m", "m/N"))
    if PROXIMAL_DISPLACEMENT in signals:
        signals[PROXIMAL_DISPLACEMENT] = signals[PROXIMAL_DISPLACEMENT] + scale.zero
    motion = (size * signal for size, signal in zip(sizes, one.motion, strict=True))
    return Simulated(signals, type(one.motion)(*motion))


def _predicted(one: Predicted, scale: BenchScale) -> Predicted:
    return Predicted(
        _out(one.record, scale), _simulated(one.before, scale), _simulated(one.after, scale)
    )


def _numbers(found: Diagnosis, scale: BenchScale) -> dict[str, Number]:
    """Return all numbers with their intervals."""
    numbers = {}
    for name, one in found.parameters.items():
        size = scale.size(one.unit)
        numbers[name] = one._replace(
            value=size * one.value,
            low=size * one.low,
            high=size * one.high,
            unit=found.units.name(one.unit),
        )
    for effect, values in found.extended.model.effects if scale.zero else ():
        numbers |= numbers_from_zero(
            effect, _values(effect.parameters, values, scale), numbers, scale.zero
        )
    return numbers


def numbers_from_zero(
    effect: Effect, values: Values, numbers: Mapping[str, Number], zero: float
) -> dict[str, Number]:
    """Return an effect's numbers for the readings of the motor's encoder that are more by `zero`.

    The intervals of its amplitudes include those of all pairs within theirs, its shape as it is:
    what another radius or wave number would do to a phase so far away is not in them.
    """
    moved = effect.from_zero(values, zero)
    if moved == values:
        return {}
    names = [f"{effect.name}.{p.name}" for p in effect.parameters]
    ends = [
        (value,) if p.neutral is None else (numbers[name].low, numbers[name].high)
        for p, name, value in zip(effect.parameters, names, values, strict=True)
    ]
    corners = [effect.from_zero(corner, zero) for corner in product(*ends)]
    at_bound = any(
        numbers[name].at_bound for name, end in zip(names, ends, strict=True) if len(end) > 1
    )
    return {
        name: numbers[name]._replace(value=value, low=min(of), high=max(of), at_bound=at_bound)
        for name, value, end, *of in zip(names, moved, ends, *corners, strict=True)
        if len(end) > 1
    }


def _ranking(ranking: tuple[Ranked, ...], scale: BenchScale) -> tuple[Ranked, ...]:
    return tuple(
        one._replace(
            rmse=_errors(one.rmse, scale), values=_of_effect(one.effect, one.values, scale)
        )
        for one in ranking
    )


def _errors(errors: Errors, scale: BenchScale) -> Errors:
    return {channel: scale.size_of(channel) * one for channel, one in errors.items()}


def _simple(model: SimpleFit, scale: BenchScale) -> SimpleFit:
    return model._replace(
        held_out={
            channel: one._replace(power=scale.size_of(channel) ** 2 * one.power)
            for channel, one in model.held_out.items()
        }
    )


def _choice(choice: Choice, scale: BenchScale) -> Choice:
    return Choice(
        _dataset(choice.dataset, scale),
        _fit(choice.fit, choice.dataset.base, scale),
        tuple(one._replace(rmse=_errors(one.rmse, scale)) for one in choice.scores),
    )


def _fitnesses(fitnesses: Fitnesses, scale: BenchScale) -> Fitnesses:
    def converted(errors: dict[str, Fitness]) -> dict[str, Fitness]:
        return {
            channel: one._replace(rmse=scale.size_of(channel) * one.rmse)
            for channel, one in errors.items()
        }

    return Fitnesses(*map(converted, fitnesses))
