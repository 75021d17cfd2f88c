"""What a diagnosis says, in the units of its records."""

from estimator.diagnosis.law_choice import Choice
from estimator.diagnosis.outcome import Diagnosis, Fitnesses, Number, Ranked
from estimator.diagnosis.prediction import Fitness
from estimator.diagnosis.simple_models import SimpleFit
from estimator.units import Units

Errors = dict[str, float]


def in_record_units(found: Diagnosis) -> Diagnosis:
    """Return a diagnosis whose numbers are in the units of its records, not newtons and metres."""
    units = found.units
    if not units.rotary:
        return found
    return found._replace(
        steps=tuple(step._replace(ranking=_ranking(step.ranking, units)) for step in found.steps),
        ranking=_ranking(found.ranking, units),
        parameters={name: _number(one, units) for name, one in found.parameters.items()},
        before=_fitnesses(found.before, units),
        after=_fitnesses(found.after, units),
        noise=_errors(found.noise, units),
        laws=_choice(found.laws, units),
        loads=_choice(found.loads, units),
        simple_models=tuple(_simple(one, units) for one in found.simple_models),
        detection_limits={
            name: one._replace(size=one.size * units.size(one.unit), unit=units.name(one.unit))
            for name, one in found.detection_limits.items()
        },
    )


def _number(one: Number, units: Units) -> Number:
    size = units.size(one.unit)
    return one._replace(
        value=size * one.value,
        low=size * one.low,
        high=size * one.high,
        unit=units.name(one.unit),
    )


def _ranking(ranking: tuple[Ranked, ...], units: Units) -> tuple[Ranked, ...]:
    return tuple(
        one._replace(
            rmse=_errors(one.rmse, units),
            values=tuple(
                units.size(p.unit) * value
                for p, value in zip(one.effect.parameters, one.values, strict=True)
            ),
        )
        for one in ranking
    )


def _errors(errors: Errors, units: Units) -> Errors:
    return {channel: units.size(units.base(channel)) * one for channel, one in errors.items()}


def _simple(model: SimpleFit, units: Units) -> SimpleFit:
    return model._replace(
        held_out={
            channel: one._replace(power=units.size(units.base(channel)) ** 2 * one.power)
            for channel, one in model.held_out.items()
        }
    )


def _choice(choice: Choice, units: Units) -> Choice:
    scores = tuple(one._replace(rmse=_errors(one.rmse, units)) for one in choice.scores)
    return choice._replace(scores=scores)


def _fitnesses(fitnesses: Fitnesses, units: Units) -> Fitnesses:
    def converted(errors: dict[str, Fitness]) -> dict[str, Fitness]:
        return {
            channel: one._replace(rmse=units.size(units.base(channel)) * one.rmse)
            for channel, one in errors.items()
        }

    return Fitnesses(*map(converted, fitnesses))
