"""Tables of a diagnosis."""

from collections.abc import Iterable, Mapping, Sequence

from estimator.diagnosis.outcome import (
    Diagnosis,
    FileForce,
    FittedValue,
    ModelErrors,
    PredictedRecord,
    RankedCandidate,
)
from estimator.diagnosis.scoring import Choice
from estimator.report_table import Table
from estimator.units import Units, format_quantity

CANDIDATES_SHOWN = 8  # candidates in a table
DIGITS_MAX = 8
SAMPLE_SETS = {"fit": "fitted", "held_out": "held out", "validation": "validation"}


def build_ranking_table(diagnosis: Diagnosis, ranking: Sequence[RankedCandidate]) -> Table:
    """Return how the candidates of one search came out, the best first."""
    channels = list_compared_channels(diagnosis)
    rows = [
        (
            candidate.label,
            f"{candidate.score:.0f}",
            *_format_rmse(diagnosis.units, channels, candidate.rmse),
            f"{candidate.residual_fraction:.0%}",
        )
        for candidate in select_best_candidates(ranking, CANDIDATES_SHOWN)
    ]
    titles = _list_rmse_titles(diagnosis, channels)
    return Table(("candidate", "score", *titles, "unexplained"), tuple(rows))


def _list_rmse_titles(diagnosis: Diagnosis, channels: Iterable[str]) -> list[str]:
    return [f"RMSE, {diagnosis.units.name_channel(channel)}" for channel in channels]


def build_parameter_table(diagnosis: Diagnosis) -> Table:
    """Return the numbers of the extended model."""
    rows = [
        (
            name,
            format_quantity(number.value, number.unit, count_interval_digits(number)),
            format_interval(number),
        )
        for name, number in diagnosis.parameters.items()
    ]
    return Table(("parameter", "value", "95 % interval"), tuple(rows))


def build_law_table(diagnosis: Diagnosis) -> Table | None:
    """Return the evidence for the base law; None where nothing was to be chosen."""
    return _build_choice_table(diagnosis, diagnosis.laws, "base law", diagnosis.dataset.base.law)


def build_load_table(diagnosis: Diagnosis) -> Table | None:
    """Return the evidence for loads that differ by file; None where nothing was to be chosen."""
    return _build_choice_table(
        diagnosis, diagnosis.loads, "load at the tip", diagnosis.dataset.base.loads
    )


def _build_choice_table(
    diagnosis: Diagnosis, choice: Choice, title: str, chosen: str
) -> Table | None:
    """Return the scores of what could be chosen, the choice marked."""
    if not choice.scores:
        return None
    channels = list_compared_channels(diagnosis)
    equivalents = choice.equivalents if len(choice.equivalents) > 1 else ()
    rows = [
        (
            score.name,
            f"{score.score:.0f}",
            *_format_rmse(diagnosis.units, channels, score.rmse),
            "chosen" if score.name == chosen else "as good" if score.name in equivalents else "",
        )
        for score in choice.scores
    ]
    return Table((title, "score", *_list_rmse_titles(diagnosis, channels), ""), tuple(rows))


def build_gain_table(diagnosis: Diagnosis) -> Table:
    """Return by how much errors fell, of held-out samples if any are."""
    rows = [
        (
            diagnosis.units.name_channel(channel),
            f"{gain.value:.1%}",
            f"{gain.low:.1%} to {gain.high:.1%}",
        )
        for channel, gain in diagnosis.gain.items()
    ]
    return Table(
        ("channel", f"{name_judged_samples(diagnosis)} RMSE falls by", "95 % interval"), tuple(rows)
    )


def build_model_table(diagnosis: Diagnosis) -> Table:
    """Return the held-out errors of the law, of models that know no sheath, and learned ones."""
    laws = {"the plain law": diagnosis.before}
    if diagnosis.steps:
        laws["the extended law"] = diagnosis.after
    errors = {name: {c: e.rmse for c, e in law.held_out.items()} for name, law in laws.items()}
    others = (*diagnosis.simple_models, *diagnosis.learned_models)
    errors |= {result.name: result.rmse for result in others}
    channels = list(diagnosis.before.held_out)
    rows = [(name, *_format_rmse(diagnosis.units, channels, e)) for name, e in errors.items()]
    channel_names = (diagnosis.units.name_channel(channel) for channel in channels)
    return Table((f"{name_judged_samples(diagnosis)} RMSE of", *channel_names), tuple(rows))


def build_simple_gain_table(diagnosis: Diagnosis) -> Table:
    """Return by how much the law is better than the best model that knows no sheath."""
    rows = [
        (
            diagnosis.units.name_channel(channel),
            gain.model,
            f"{gain.value:.1%}",
            f"{gain.low:.1%} to {gain.high:.1%}",
        )
        for channel, gain in diagnosis.simple_gain.items()
    ]
    lower = f"{name_judged_samples(diagnosis)} RMSE of the law is lower by"
    head = ("channel", "best simple model", lower, "95 % interval")
    return Table(head, tuple(rows))


def build_error_table(diagnosis: Diagnosis) -> Table:
    """Return the errors of both models, by channel and by what they were judged on."""
    rows = []
    for name, samples_name in SAMPLE_SETS.items():
        if diagnosis.fit_all and name == "held_out":
            continue
        for channel in getattr(diagnosis.before, name):
            pair = [
                _format_errors(diagnosis, model, name, channel)
                for model in (diagnosis.before, diagnosis.after)
            ]
            cells = [cell for stage_pair in zip(*pair, strict=True) for cell in stage_pair]
            rows.append((diagnosis.units.name_channel(channel), samples_name, *cells))
    head = tuple(
        f"{item}, {stage}" for item in ("RMSE", "largest", "mean") for stage in _MODEL_STAGES
    )
    return Table(("channel", "data", *head), tuple(rows))


def build_detection_limit_table(diagnosis: Diagnosis) -> Table:
    """Return the smallest effects that would have been seen."""
    rows = [
        (name, limit.parameter, format_quantity(limit.size, limit.unit, 2))
        for name, limit in diagnosis.detection_limits.items()
    ]
    return Table(("effect", "parameter", "would have been seen from"), tuple(rows))


def name_judged_samples(diagnosis: Diagnosis) -> str:
    """Return which errors are stated: of samples that were held out, or of fitted ones."""
    return "in-sample" if diagnosis.fit_all else "held-out"


def select_best_candidates(ranking: Iterable[RankedCandidate], count: int) -> list[RankedCandidate]:
    """Return the candidates of highest score, the best first."""
    return sorted(ranking, key=lambda ranked: -ranked.score)[:count]


def list_compared_channels(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return the channels that the model was compared with."""
    return tuple(dict.fromkeys(c for r in diagnosis.dataset.records for c in r.compared))


def format_interval(number: FittedValue) -> str:
    """Return from where to where a value may be."""
    ends = (
        format_quantity(end, number.unit, count_interval_digits(number))
        for end in (number.low, number.high)
    )
    return " to ".join(ends) + (", at its bound" if number.at_bound else "")


def count_interval_digits(number: FittedValue) -> int:
    """Return how many digits tell the ends of an interval apart."""
    for count in range(4, DIGITS_MAX):
        if f"{number.low:.{count}g}" != f"{number.high:.{count}g}":
            return count
    return DIGITS_MAX


_MODEL_STAGES = ("before", "after")


def _format_errors(
    diagnosis: Diagnosis, model: ModelErrors, name: str, channel: str
) -> tuple[str, ...]:
    statistics = getattr(model, name).get(channel)
    if statistics is None:
        return "", "", ""
    return (
        format_quantity(statistics.rmse, diagnosis.units.get_unit(channel), 3),
        f"{statistics.largest:.2%}",
        f"{statistics.mean:.2%}",
    )


def name_records(diagnosis: Diagnosis, files: Sequence[str], further: Sequence[str]) -> list[str]:
    """Return what all records are called, the fitted ones first; numbered where not given."""
    fitted_names = list(files) or [f"record {k + 1}" for k in range(len(diagnosis.dataset.records))]
    validation_names = list(further) or [
        f"validation {k + 1}" for k in range(len(diagnosis.validation))
    ]
    return fitted_names + validation_names


def build_prediction_table(records: Sequence[PredictedRecord], names: Sequence[str]) -> Table:
    """Return the errors of both models in records that were not fitted, by file and channel."""
    rows = []
    for name, prediction in zip(names, records, strict=True):
        before, after = prediction.fitness(prediction.before), prediction.fitness(prediction.after)
        start, units = prediction.record.start, prediction.record.units
        times = f"{start:.6g} to {start + float(prediction.record.time[-1]):.6g} s"
        rows += [
            (
                name,
                times,
                units.name_channel(channel),
                str(int(prediction.record.valid[channel].sum())),
                str(prediction.spikes[channel]),
                format_quantity(before[channel].rmse, units.get_unit(channel), 3),
                format_quantity(after[channel].rmse, units.get_unit(channel), 3),
                f"{after[channel].mean:.2%}",
                f"{after[channel].largest:.2%}",
            )
            for channel in prediction.record.compared
        ]
    head = ("file", "time", "channel", "samples", "spikes excluded", "RMSE before", "RMSE after")
    return Table((*head, "mean after", "largest after"), tuple(rows))


def _format_rmse(units: Units, channels: Iterable[str], errors: Mapping[str, float]) -> list[str]:
    """Return the error of each channel, empty where there is none."""
    return [
        format_quantity(errors.get(channel), units.get_unit(channel), 3) for channel in channels
    ]


def build_force_table(diagnosis: Diagnosis, names: Sequence[str]) -> Table:
    """Return the error of the force that `teleop estimate` and `run --replay` would give."""
    head = ("force at the tip in", "data", "samples", "spikes excluded", "RMSE before")
    rows = [
        (name, "validation" if force.validation else "fitted", *_format_force_errors(force))
        for name, force in zip(names, diagnosis.forces, strict=True)
    ]
    return Table((*head, "RMSE after", "mean after", "largest after"), tuple(rows))


def _format_force_errors(force: FileForce) -> tuple[str, ...]:
    after = force.after
    errors = (force.before.rmse, after.rmse, after.mean, after.largest)
    return (
        str(after.samples),
        str(after.spikes),
        *(_format_with_full_scale(error, after.full_scale) for error in errors),
    )


def build_rival_table(diagnosis: Diagnosis) -> Table:
    """Return what each rival in the model would do to the estimated force."""
    rows = [
        (
            rival.label,
            rival.replaces,
            _format_with_full_scale(rival.mean, rival.full_scale),
            _format_with_full_scale(rival.largest, rival.full_scale),
        )
        for rival in diagnosis.rival_forces
    ]
    head = ("rival", "in the place of", "mean change of the force", "largest")
    return Table(head, tuple(rows))


def build_rival_parameter_table(diagnosis: Diagnosis) -> Table:
    """Return the parameters of each rival's model, fitted to all samples."""
    names = [parameter.name for parameter in diagnosis.dataset.base.shared]
    units, rows = diagnosis.units, []
    for rival in diagnosis.rivals:
        model = rival.fit.model
        values = [
            f"{name} {format_quantity(value, units.name_unit(parameter.unit))}"
            for name, value, parameter in zip(
                names, model.shared, diagnosis.dataset.base.shared, strict=True
            )
        ]
        for effect, numbers in model.effects:
            values += [
                f"{effect.name}.{p.name} {format_quantity(value, units.name_unit(p.unit))}"
                for p, value in zip(effect.parameters, numbers, strict=True)
            ]
        rows.append((rival.effect.label, rival.replaces, ", ".join(values)))
    return Table(("rival", "in the place of", "parameters of its model"), tuple(rows))


def _format_with_full_scale(error: float, full_scale: float) -> str:
    share = f" ({error / full_scale:.1%})" if full_scale > 0.0 else ""
    return f"{format_quantity(error, 'N', 3)}{share}"
