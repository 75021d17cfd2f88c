"""Records in the units of their bench, and what a diagnosis says in those of its records."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

from estimator.diagnosis.dataset import (
    TAUT_TRAVEL,
    BaseParameters,
    Dataset,
    Fit,
    Model,
    SimulatedRecord,
)
from estimator.diagnosis.outcome import (
    Curve,
    Diagnosis,
    ErrorStatistics,
    FittedValue,
    LiveError,
    ModelErrors,
    PredictedRecord,
    RankedCandidate,
)
from estimator.diagnosis.record import (
    UNIT_SCALE,
    BenchScale,
    Record,
    choose_bench_scale,
    collect_efforts,
)
from estimator.diagnosis.scoring import Choice, SimpleFit
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


def to_record_units(diagnosis: Diagnosis, scale: BenchScale) -> Diagnosis:
    """Return a diagnosis in the units of its records, made in those of their bench."""
    units, base = diagnosis.units, diagnosis.dataset.base

    def fit(original: Fit) -> Fit:
        return _unscale_fit(original, base, scale)

    return diagnosis._replace(
        scale=scale,
        steps=tuple(
            step._replace(ranking=_unscale_ranking(step.ranking, scale), fit=fit(step.fit))
            for step in diagnosis.steps
        ),
        ranking=_unscale_ranking(diagnosis.ranking, scale),
        parameters=_unscale_numbers(diagnosis, scale),
        dataset=_unscale_dataset(diagnosis.dataset, scale),
        baseline=fit(diagnosis.baseline),
        extended=fit(diagnosis.extended),
        before=_unscale_model_errors(diagnosis.before, scale),
        after=_unscale_model_errors(diagnosis.after, scale),
        noise=_unscale_errors(diagnosis.noise, scale),
        laws=_unscale_choice(diagnosis.laws, scale),
        loads=_unscale_choice(diagnosis.loads, scale),
        simple_models=tuple(_unscale_simple_fit(m, scale) for m in diagnosis.simple_models),
        learned_models=tuple(_unscale_simple_fit(m, scale) for m in diagnosis.learned_models),
        detection_limits={
            name: original._replace(
                size=original.size * scale.size(original.unit), unit=units.name_unit(original.unit)
            )
            for name, original in diagnosis.detection_limits.items()
        },
        rivals=tuple(original._replace(fit=fit(original.fit)) for original in diagnosis.rivals),
        validation=tuple(_unscale_prediction(original, scale) for original in diagnosis.validation),
        left_out=tuple(_unscale_prediction(original, scale) for original in diagnosis.left_out),
        curve=_unscale_curve(diagnosis.curve, scale),
        live_error=diagnosis.live_error
        and LiveError(*(scale.force * error for error in diagnosis.live_error)),
    )


def _unscale_curve(curve: Curve | None, scale: BenchScale) -> Curve | None:
    if curve is None or curve.effect.function is None:
        return curve
    size, term = scale.size(curve.unit), curve.effect.function
    zero = curve.effect.shift_encoder_zero((0.0, 0.0), scale.zero)[0]
    return curve._replace(
        x=scale.size(term.unit) * curve.x + zero,
        value=size * curve.value,
        half_width=size * curve.half_width,
    )


def _convert_record(record: Record, unit_scale: BenchScale, scale: BenchScale) -> Record:
    """Return a record in the units of `unit_scale`, with `scale` as its new scale."""
    signals = {name: signal / unit_scale.size_of(name) for name, signal in record.signals.items()}
    unit = unit_scale.size_of(record.driver)
    zero = unit_scale.zero if record.driver == PROXIMAL_DISPLACEMENT else 0.0
    if zero:
        signals[record.driver] = (record.signals[record.driver] - zero) / unit
    return replace(
        record,
        signals=signals,
        drive=(record.drive - zero) / unit,
        speed=record.speed / unit,
        noise={name: sigma / unit_scale.size_of(name) for name, sigma in record.noise.items()},
        sigma={name: sigma / unit_scale.size_of(name) for name, sigma in record.sigma.items()},
        scale=scale,
    )


def _unscale_record(record: Record, scale: BenchScale) -> Record:
    return _convert_record(record, scale.inverse, UNIT_SCALE)


def _unscale_dataset(dataset: Dataset, scale: BenchScale) -> Dataset:
    return dataset._replace(
        records=tuple(_unscale_record(record, scale) for record in dataset.records),
        scale=tuple(
            {name: scale.size_of(name) * sigma for name, sigma in sigmas.items()}
            for sigmas in dataset.scale
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
        tuple(_unscale_simulated_record(simulated, scale) for simulated in fit.simulated),
    )


def _unscale_values(parameters: Sequence[Parameter], values: Values, scale: BenchScale) -> Values:
    return tuple(scale.size(p.unit) * value for p, value in zip(parameters, values, strict=True))


def _unscale_own_values(base: BaseParameters, own: Values, scale: BenchScale) -> Values:
    zeros = (scale.zero if p == TAUT_TRAVEL else 0.0 for p in base.own)
    return tuple(a + b for a, b in zip(_unscale_values(base.own, own, scale), zeros, strict=True))


def _unscale_effect_values(effect: Effect, values: Values, scale: BenchScale) -> Values:
    return effect.shift_encoder_zero(_unscale_values(effect.parameters, values, scale), scale.zero)


def _unscale_simulated_record(simulated: SimulatedRecord, scale: BenchScale) -> SimulatedRecord:
    """Return what was simulated; the motion's travel counts from the slack tendon on anyway."""
    signals = {name: scale.size_of(name) * signal for name, signal in simulated.signals.items()}
    sizes = map(scale.size, ("N", "N", "m", "m", "m/N"))
    if PROXIMAL_DISPLACEMENT in signals:
        signals[PROXIMAL_DISPLACEMENT] = signals[PROXIMAL_DISPLACEMENT] + scale.zero
    motion = (size * signal for size, signal in zip(sizes, simulated.motion, strict=True))
    return SimulatedRecord(signals, type(simulated.motion)(*motion))


def _unscale_prediction(prediction: PredictedRecord, scale: BenchScale) -> PredictedRecord:
    return PredictedRecord(
        _unscale_record(prediction.record, scale),
        _unscale_simulated_record(prediction.before, scale),
        _unscale_simulated_record(prediction.after, scale),
    )


def _unscale_numbers(diagnosis: Diagnosis, scale: BenchScale) -> dict[str, FittedValue]:
    """Return all numbers with their intervals."""
    numbers = {}
    for name, number in diagnosis.parameters.items():
        size = scale.size(number.unit)
        numbers[name] = number._replace(
            value=size * number.value,
            low=size * number.low,
            high=size * number.high,
            unit=diagnosis.units.name_unit(number.unit),
        )
    effects = [pair for pair in diagnosis.extended.model.effects if pair[0].function is None]
    for effect, values in effects if scale.zero else ():
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
    shifted = effect.shift_encoder_zero(values, zero)
    if shifted == values:
        return {}
    names = [f"{effect.name}.{p.name}" for p in effect.parameters]
    ends = [
        (value,) if p.neutral is None else (numbers[name].low, numbers[name].high)
        for p, name, value in zip(effect.parameters, names, values, strict=True)
    ]
    corners = [effect.shift_encoder_zero(corner, zero) for corner in product(*ends)]
    at_bound = any(
        numbers[name].at_bound for name, end in zip(names, ends, strict=True) if len(end) > 1
    )
    return {
        name: numbers[name]._replace(
            value=value, low=min(corner_values), high=max(corner_values), at_bound=at_bound
        )
        for name, value, end, *corner_values in zip(names, shifted, ends, *corners, strict=True)
        if len(end) > 1
    }


def _unscale_ranking(
    ranking: tuple[RankedCandidate, ...], scale: BenchScale
) -> tuple[RankedCandidate, ...]:
    return tuple(
        candidate._replace(
            rmse=_unscale_errors(candidate.rmse, scale),
            values=_unscale_effect_values(candidate.effect, candidate.values, scale),
        )
        for candidate in ranking
    )


def _unscale_errors(errors: RmseByChannel, scale: BenchScale) -> RmseByChannel:
    return {channel: scale.size_of(channel) * error for channel, error in errors.items()}


def _unscale_simple_fit(model: SimpleFit, scale: BenchScale) -> SimpleFit:
    return model._replace(
        held_out={
            channel: errors._replace(
                sum_of_squares=scale.size_of(channel) ** 2 * errors.sum_of_squares
            )
            for channel, errors in model.held_out.items()
        }
    )


def _unscale_choice(choice: Choice, scale: BenchScale) -> Choice:
    return Choice(
        _unscale_dataset(choice.dataset, scale),
        _unscale_fit(choice.fit, choice.dataset.base, scale),
        tuple(score._replace(rmse=_unscale_errors(score.rmse, scale)) for score in choice.scores),
    )


def _unscale_model_errors(model_errors: ModelErrors, scale: BenchScale) -> ModelErrors:
    def unscale(errors: dict[str, ErrorStatistics]) -> dict[str, ErrorStatistics]:
        return {
            channel: statistics._replace(rmse=scale.size_of(channel) * statistics.rmse)
            for channel, statistics in errors.items()
        }

    return ModelErrors(*map(unscale, model_errors))
