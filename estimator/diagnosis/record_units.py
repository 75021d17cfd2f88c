"""Records in the units of their bench, and what a diagnosis says in those of its records."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

from estimator.diagnosis.baseline import Choice
from estimator.diagnosis.bench_scale import UNIT_SCALE, BenchScale, choose_bench_scale
from estimator.diagnosis.dataset import Dataset, Fit, Model
from estimator.diagnosis.model import TAUT_TRAVEL, BaseParameters, SimulatedRecord
from estimator.diagnosis.outcome import Diagnosis, FittedValue, ModelErrors, RankedCandidate
from estimator.diagnosis.prediction import ErrorStatistics, PredictedRecord
from estimator.diagnosis.record import Record, collect_efforts
from estimator.diagnosis.simple_models import SimpleFit
from estimator.effects.effect import (
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Effect,
    Parameter,
    Values,
)

RmseByChannel = dict[str, float]


def compute_bench_scale(records: Sequence[Record]) -> BenchScale:
    """Return the scale of the bench that records are of."""
    efforts = [effort for record in records for effort in collect_efforts(record.signals)]
    travels = [record.drive for record in records if record.driver != PROXIMAL_TENSION]
    if not travels and records[0].units.rotary:
        travels = [
            signal
            for record in records
            for name, signal in record.signals.items()
            if name.endswith("displacement")
        ]
    return choose_bench_scale(efforts, travels)


def to_bench_units(record: Record, scale: BenchScale) -> Record:
    """Return a record in the units of its bench."""
    return _convert_record(record, scale, scale)


def to_record_units(found: Diagnosis, scale: BenchScale) -> Diagnosis:
    """Return a diagnosis in the units of its records, made in those of their bench."""
    units, base = found.units, found.dataset.base

    def fit(one: Fit) -> Fit:
        return _unscale_fit(one, base, scale)

    return found._replace(
        scale=scale,
        steps=tuple(
            step._replace(ranking=_unscale_ranking(step.ranking, scale), fit=fit(step.fit))
            for step in found.steps
        ),
        ranking=_unscale_ranking(found.ranking, scale),
        parameters=_unscale_numbers(found, scale),
        dataset=_unscale_dataset(found.dataset, scale),
        baseline=fit(found.baseline),
        extended=fit(found.extended),
        before=_unscale_model_errors(found.before, scale),
        after=_unscale_model_errors(found.after, scale),
        noise=_unscale_errors(found.noise, scale),
        laws=_unscale_choice(found.laws, scale),
        loads=_unscale_choice(found.loads, scale),
        simple_models=tuple(_unscale_simple_fit(one, scale) for one in found.simple_models),
        detection_limits={
            name: one._replace(size=one.size * scale.size(one.unit), unit=units.name(one.unit))
            for name, one in found.detection_limits.items()
        },
        rivals=tuple(one._replace(fit=fit(one.fit)) for one in found.rivals),
        validation=tuple(_unscale_prediction(one, scale) for one in found.validation),
        left_out=tuple(_unscale_prediction(one, scale) for one in found.left_out),
    )


def _convert_record(record: Record, by: BenchScale, scale: BenchScale) -> Record:
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


def _unscale_record(record: Record, scale: BenchScale) -> Record:
    return _convert_record(record, scale.inverse, UNIT_SCALE)


def _unscale_dataset(dataset: Dataset, scale: BenchScale) -> Dataset:
    return dataset._replace(
        records=tuple(_unscale_record(record, scale) for record in dataset.records),
        scale=tuple(
            {name: scale.size_of(name) * sigma for name, sigma in each.items()}
            for each in dataset.scale
        ),
    )


def _unscale_fit(fit: Fit, base: BaseParameters, scale: BenchScale) -> Fit:
    model = fit.model
    return Fit(
        Model(
            _unscale_values(base.shared, model.shared, scale),
            tuple(_unscale_own_values(base, own, scale) for own in model.own),
            tuple(
                (effect, _unscale_effect_values(effect, values, scale))
                for effect, values in model.effects
            ),
        ),
        tuple(_unscale_simulated_record(one, scale) for one in fit.simulated),
    )


def _unscale_values(parameters: Sequence[Parameter], values: Values, scale: BenchScale) -> Values:
    return tuple(scale.size(p.unit) * value for p, value in zip(parameters, values, strict=True))


def _unscale_own_values(base: BaseParameters, own: Values, scale: BenchScale) -> Values:
    zeros = (scale.zero if p == TAUT_TRAVEL else 0.0 for p in base.own)
    return tuple(a + b for a, b in zip(_unscale_values(base.own, own, scale), zeros, strict=True))


def _unscale_effect_values(effect: Effect, values: Values, scale: BenchScale) -> Values:
    return effect.from_zero(_unscale_values(effect.parameters, values, scale), scale.zero)


def _unscale_simulated_record(one: SimulatedRecord, scale: BenchScale) -> SimulatedRecord:
    """Return what was simulated; the motion's travel counts from the slack tendon on anyway."""
    signals = {name: scale.size_of(name) * signal for name, signal in one.signals.items()}
    sizes = map(scale.size, ("N", "N", "m", "m", "m/N"))
    if PROXIMAL_DISPLACEMENT in signals:
        signals[PROXIMAL_DISPLACEMENT] = signals[PROXIMAL_DISPLACEMENT] + scale.zero
    motion = (size * signal for size, signal in zip(sizes, one.motion, strict=True))
    return SimulatedRecord(signals, type(one.motion)(*motion))


def _unscale_prediction(one: PredictedRecord, scale: BenchScale) -> PredictedRecord:
    return PredictedRecord(
        _unscale_record(one.record, scale),
        _unscale_simulated_record(one.before, scale),
        _unscale_simulated_record(one.after, scale),
    )


def _unscale_numbers(found: Diagnosis, scale: BenchScale) -> dict[str, FittedValue]:
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
        numbers |= shift_encoder_zero(
            effect, _unscale_values(effect.parameters, values, scale), numbers, scale.zero
        )
    return numbers


def shift_encoder_zero(
    effect: Effect, values: Values, numbers: Mapping[str, FittedValue], zero: float
) -> dict[str, FittedValue]:
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


def _unscale_ranking(
    ranking: tuple[RankedCandidate, ...], scale: BenchScale
) -> tuple[RankedCandidate, ...]:
    return tuple(
        one._replace(
            rmse=_unscale_errors(one.rmse, scale),
            values=_unscale_effect_values(one.effect, one.values, scale),
        )
        for one in ranking
    )


def _unscale_errors(errors: RmseByChannel, scale: BenchScale) -> RmseByChannel:
    return {channel: scale.size_of(channel) * one for channel, one in errors.items()}


def _unscale_simple_fit(model: SimpleFit, scale: BenchScale) -> SimpleFit:
    return model._replace(
        held_out={
            channel: one._replace(power=scale.size_of(channel) ** 2 * one.power)
            for channel, one in model.held_out.items()
        }
    )


def _unscale_choice(choice: Choice, scale: BenchScale) -> Choice:
    return Choice(
        _unscale_dataset(choice.dataset, scale),
        _unscale_fit(choice.fit, choice.dataset.base, scale),
        tuple(one._replace(rmse=_unscale_errors(one.rmse, scale)) for one in choice.scores),
    )


def _unscale_model_errors(fitnesses: ModelErrors, scale: BenchScale) -> ModelErrors:
    def converted(errors: dict[str, ErrorStatistics]) -> dict[str, ErrorStatistics]:
        return {
            channel: one._replace(rmse=scale.size_of(channel) * one.rmse)
            for channel, one in errors.items()
        }

    return ModelErrors(*map(converted, fitnesses))
