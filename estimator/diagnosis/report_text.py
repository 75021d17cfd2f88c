"""A diagnosis in words: the verdict in one sentence, tables of text, and what to do next."""

import re
from collections.abc import Iterable, Sequence

from estimator.diagnosis.baseline import Choice
from estimator.diagnosis.dataset import compute_tolerance
from estimator.diagnosis.model import TIP_COMPLIANCE
from estimator.diagnosis.outcome import (
    CauseStep,
    DetectionLimit,
    Diagnosis,
    FittedValue,
    ModelErrors,
    RankedCandidate,
    Verdict,
)
from estimator.diagnosis.settings import SETTINGS
from estimator.diagnosis.simple_models import LUGRE
from estimator.effects import CATALOGUE, Effect
from estimator.effects.effect import (
    CHANNELS,
    DISTAL_DISPLACEMENT,
    DISTAL_TENSION,
    PROXIMAL_TENSION,
)
from estimator.text_table import Table
from estimator.units import format_quantity

CANDIDATES_SHOWN = 8  # candidates in a table
DEPENDENCES_SHOWN = 2  # named in a sentence
UNSURE_CAUSES_SHOWN = 3  # causes in a sentence, none of them sure
DIGITS_MAX = 8
SAMPLE_SETS = {"fit": "fitted", "held_out": "held out", "validation": "validation"}


def format_verdict(found: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    if found.verdict is Verdict.CLEAN:
        smallest = _describe_detection_limits(found.detection_limits)
        return f"Nothing is wrong with the model beyond noise{smallest}."
    if found.verdict is Verdict.UNEXPLAINED:
        if found.wanders:
            labels = " and ".join(step.effect.label for step in found.steps)
            return (
                f"The model is wrong, and nothing in the catalogue explains it: friction changes "
                f"with time, and {labels} is only the closest match in the catalogue."
            )
        if names := _list_unsure_causes(found):
            return (
                f"The model is wrong, and these data do not determine the cause: "
                f"{' or '.join(names)} would explain it, none of them surely; "
                f"{_describe_dependence(found)}."
            )
        labels = " and ".join(step.effect.label for step in found.steps)
        share = f"{found.left:.0%} of what noise does not explain"
        still = f"with {labels} in the model {share} is left, and " if found.steps else ""
        return (
            f"The model is wrong, and nothing in the catalogue explains it: {still}"
            f"{_describe_dependence(found)}."
        )
    causes = " and ".join(f"because {_describe_cause(found, step)}" for step in found.steps)
    unsure = "; these channels cannot tell which" * (found.verdict is Verdict.AMBIGUOUS)
    return f"The model is wrong {causes}{unsure}; {_describe_gain(found)}."


def format_summary(
    found: Diagnosis,
    files: Sequence[str] = (),
    compared: Table | None = None,
    further: Sequence[str] = (),
) -> str:
    """Return all that is said of a diagnosis: the verdict, tables, residuals, next steps.

    Parameters
    ----------
    found : Diagnosis
        What was found.
    files : sequence of str, optional
        What the records are called; "record 1" and so on by default.
    compared : Table, optional
        A calibration beside what the data say.
    further : sequence of str, optional
        What the records for validation are called.
    """
    from estimator.diagnosis import file_tables  # which imports this module

    named = file_tables.name_records(found, files, further)
    warnings = [f"WARNING: {what}" for what in list_better_models(found)]
    parts = ["\n".join([format_verdict(found), *warnings])]
    parts += [table.markdown() for table in build_tables(found, files, compared, further)]
    parts.append("Residuals:\n" + "\n".join(f"- {what}" for what in describe_residuals(found)))
    parts.append("Next:\n" + "\n".join(f"- {step}" for step in list_next_steps(found)))
    if said := list_sample_remarks(found, named[: len(found.dataset.records)]):
        parts.append("Samples:\n" + "\n".join(f"- {remark}" for remark in said))
    return "\n\n".join(parts)


def build_tables(
    found: Diagnosis,
    files: Sequence[str] = (),
    compared: Table | None = None,
    further: Sequence[str] = (),
) -> list[Table]:
    """Return the tables of a diagnosis; for the parameters see `format_summary`."""
    from estimator.diagnosis import file_tables  # which imports this module

    names = file_tables.name_records(found, files, further)
    named = names[: len(found.dataset.records)]
    shown = [build_candidate_table(found)] if found.ranking else []
    shown.append(build_parameter_table(found))
    shown += [one for one in (build_law_table(found), build_load_table(found)) if one is not None]
    if compared is not None:
        shown.append(compared)
    if found.steps:
        shown.append(build_gain_table(found))
    shown += [build_model_table(found), build_simple_gain_table(found)]
    if found.validation:
        shown.append(file_tables.build_prediction_table(found.validation, names[len(named) :]))
    if found.left_out:
        left_out = [f"{name}, left out" for name in named]
        shown.append(file_tables.build_prediction_table(found.left_out, left_out))
    if found.forces:
        shown.append(file_tables.build_force_table(found, names))
    if found.rival_forces:
        shown.append(file_tables.build_rival_table(found))
    if found.detection_limits:
        shown.append(build_detection_limit_table(found))
    return shown


def build_candidate_table(found: Diagnosis) -> Table:
    """Return how the candidates of the first search came out, the best first."""
    return build_ranking_table(found, found.ranking)


def build_ranking_table(found: Diagnosis, ranking: Sequence[RankedCandidate]) -> Table:
    """Return how the candidates of one search came out, the best first."""
    channels = list_compared_channels(found)
    rows = [
        (
            one.label,
            f"{one.score:.0f}",
            *(format_quantity(one.rmse.get(c), found.units.of(c), 3) for c in channels),
            f"{one.left:.0%}",
        )
        for one in select_best_candidates(ranking, CANDIDATES_SHOWN)
    ]
    head = (
        "candidate",
        "score",
        *(f"RMSE, {found.units.word(c)}" for c in channels),
        "unexplained",
    )
    return Table(head, tuple(rows))


def build_parameter_table(found: Diagnosis) -> Table:
    """Return the numbers of the extended model."""
    rows = [
        (
            name,
            format_quantity(number.value, number.unit, count_interval_digits(number)),
            format_interval(number),
        )
        for name, number in found.parameters.items()
    ]
    return Table(("parameter", "value", "95 % interval"), tuple(rows))


def build_law_table(found: Diagnosis) -> Table | None:
    """Return the evidence for the base law; None where nothing was to be chosen."""
    return _build_choice_table(found, found.laws, "base law", found.dataset.base.law)


def build_load_table(found: Diagnosis) -> Table | None:
    """Return the evidence for loads that differ by file; None where nothing was to be chosen."""
    return _build_choice_table(found, found.loads, "load at the tip", found.dataset.base.loads)


def _build_choice_table(found: Diagnosis, choice: Choice, what: str, chosen: str) -> Table | None:
    """Return the scores of what could be chosen, the choice marked."""
    if not choice.scores:
        return None
    channels = list_compared_channels(found)
    alike = choice.alike if len(choice.alike) > 1 else ()
    rows = [
        (
            one.name,
            f"{one.score:.0f}",
            *(format_quantity(one.rmse[c], found.units.of(c), 3) for c in channels),
            "chosen" if one.name == chosen else "as good" if one.name in alike else "",
        )
        for one in choice.scores
    ]
    head = (what, "score", *(f"RMSE, {found.units.word(c)}" for c in channels), "")
    return Table(head, tuple(rows))


def build_gain_table(found: Diagnosis) -> Table:
    """Return by how much errors fell, of held-out samples if any are."""
    rows = [
        (found.units.word(channel), f"{gain.value:.1%}", f"{gain.low:.1%} to {gain.high:.1%}")
        for channel, gain in found.gain.items()
    ]
    return Table(
        ("channel", f"{name_judged_samples(found)} RMSE falls by", "95 % interval"), tuple(rows)
    )


def build_model_table(found: Diagnosis) -> Table:
    """Return the held-out errors of the law and of models that know no sheath."""
    errors = {"the plain law": {c: one.rmse for c, one in found.before.held_out.items()}}
    if found.steps:
        errors["the extended law"] = {c: one.rmse for c, one in found.after.held_out.items()}
    errors |= {one.name: one.rmse for one in found.simple_models}
    channels = list(found.before.held_out)
    rows = [
        (
            name,
            *(format_quantity(rmse[channel], found.units.of(channel), 3) for channel in channels),
        )
        for name, rmse in errors.items()
    ]
    words = (found.units.word(channel) for channel in channels)
    return Table((f"{name_judged_samples(found)} RMSE of", *words), tuple(rows))


def build_simple_gain_table(found: Diagnosis) -> Table:
    """Return by how much the law is better than the best model that knows no sheath."""
    rows = [
        (
            found.units.word(channel),
            gain.model,
            f"{gain.value:.1%}",
            f"{gain.low:.1%} to {gain.high:.1%}",
        )
        for channel, gain in found.simple_gain.items()
    ]
    lower = f"{name_judged_samples(found)} RMSE of the law is lower by"
    head = ("channel", "best simple model", lower, "95 % interval")
    return Table(head, tuple(rows))


def list_better_models(found: Diagnosis) -> list[str]:
    """Return in which channels a model that knows no sheath is surely better, and what to do."""
    said, floor = [], compute_tolerance(found.dataset)
    for channel, gain in found.simple_gain.items():
        one, noise = found.after.held_out[channel], found.noise[channel]
        if gain.high < 0.0 and one.rmse > SETTINGS.noise_ratio * floor[channel] * noise:
            simple = next(m for m in found.simple_models if m.name == gain.model)
            unit = found.units.of(channel)
            said.append(
                f"{found.units.word(channel)}: {gain.model} predicts it better than this model, "
                f"{format_quantity(simple.rmse[channel], unit, 3)} against "
                f"{format_quantity(one.rmse, unit, 3)} "
                f"{name_judged_samples(found)} RMSE; {_suggest_remedy(found, gain.model)}."
            )
    return said


def _suggest_remedy(found: Diagnosis, model: str) -> str:
    """Return what to do where a simple model is better than the law."""
    like_it = ("presliding", "stribeck_friction") if model == LUGRE else ("distributed_play",)
    missing = [name for name in like_it if name not in found.causes]
    if missing and DISTAL_TENSION in found.dataset.records[0].signals:
        asked = ",".join([*found.causes, *missing])
        return f"test the effect that is like it, with --effects {asked}"
    return "do not trust the estimate beyond that error, and look at what the residuals depend on"


def build_error_table(found: Diagnosis) -> Table:
    """Return the errors of both models, by channel and by what they were judged on."""
    rows = []
    for name, words in SAMPLE_SETS.items():
        if found.fit_all and name == "held_out":
            continue
        for channel in getattr(found.before, name):
            pair = [
                _format_errors(found, model, name, channel) for model in (found.before, found.after)
            ]
            cells = [cell for both in zip(*pair, strict=True) for cell in both]
            rows.append((found.units.word(channel), words, *cells))
    head = tuple(
        f"{item}, {when}" for item in ("RMSE", "largest", "mean") for when in _MODEL_STAGES
    )
    return Table(("channel", "data", *head), tuple(rows))


def list_next_steps(found: Diagnosis) -> list[str]:
    """Return what a person does next, most useful first."""
    steps = [f"To tell the causes apart: {what}." for what in found.experiments]
    effects = [step.effect for step in found.steps]
    effects += [effect for name in found.ambiguous_with for effect in _find_effects(name)[:1]]
    advice = {effect.advice: effect.name for effect in reversed(effects)}
    steps += [f"{name}: {words}" for words, name in reversed(advice.items())]
    if found.dataset.records[0].driver == PROXIMAL_TENSION and (
        rough := _list_length_parameters(found)
    ):
        units, motor = found.units, "angle" if found.units.rotary else "travel"
        assumed = SETTINGS.assumed_compliance * found.scale.size("m/N")
        steps.append(
            f"Record the motor's {motor}: without it {', '.join(rough)} "
            f"hold for an L/EA of {format_quantity(assumed, units.name('m/N'))} only."
        )
    if found.verdict is Verdict.UNEXPLAINED and _list_unsure_causes(found):
        steps.append(
            "Record for longer, with swings of several depths and speeds, so that a cause can be "
            "told in one part of the data and tested in another."
        )
    elif found.verdict is Verdict.UNEXPLAINED:
        steps.append(
            "Look at what is left against tension, speed and time, and do not trust the estimate "
            "beyond it; a cause that the catalogue lacks is an effect to add to it."
        )
    return steps or ["Use the model as it is."]


def list_sample_remarks(found: Diagnosis, files: Sequence[str]) -> list[str]:
    """Return which samples were excluded, averaged, or are odd."""
    said = []
    for file, record in zip(files, found.dataset.records, strict=True):
        said += [
            f"{file}: {trouble.samples} {trouble.what} ({_name_channel(found, trouble.channel)}), "
            f"the first at {trouble.first:.4g} s"
            for trouble in record.troubles
        ]
        if record.thinned > 1:
            said.append(
                f"{file}: each {record.thinned} samples were averaged to one; what happens "
                "faster is not seen"
            )
    return said


def describe_residuals(found: Diagnosis) -> list[str]:
    """Return what the extended model leaves in each channel, and what that depends on."""
    said, floor = [], compute_tolerance(found.dataset)
    for channel, one in found.after.held_out.items():
        unit, noise = found.units.of(channel), found.noise[channel]
        along = [
            f"{s.what} ({s.share:.0%} of its variance)"
            for s in found.structure
            if s.channel == channel
        ]
        if one.rmse < SETTINGS.noise_ratio * floor[channel] * noise:
            what = "no more than noise and the simulation's own error"
        elif along:
            what = f"the residual depends on {', '.join(along)}"
        else:
            what = "it depends on no tension, speed, direction, travel or time"
        said.append(
            f"{found.units.word(channel)}: {format_quantity(one.rmse, unit, 3)} "
            f"{name_judged_samples(found)} RMSE, "
            f"noise is {format_quantity(noise, unit, 2)}; {what}."
        )
    return said


def build_detection_limit_table(found: Diagnosis) -> Table:
    """Return the smallest effects that would have been seen."""
    rows = [
        (name, least.parameter, format_quantity(least.size, least.unit, 2))
        for name, least in found.detection_limits.items()
    ]
    return Table(("effect", "parameter", "would have been seen from"), tuple(rows))


def name_judged_samples(found: Diagnosis) -> str:
    """Return which errors are stated: of samples that were held out, or of fitted ones."""
    return "in-sample" if found.fit_all else "held-out"


def select_best_candidates(ranking: Iterable[RankedCandidate], most: int) -> list[RankedCandidate]:
    """Return the candidates of highest score, the best first."""
    return sorted(ranking, key=lambda ranked: -ranked.score)[:most]


def list_compared_channels(found: Diagnosis) -> tuple[str, ...]:
    """Return the channels that the model was compared with."""
    return tuple(dict.fromkeys(c for r in found.dataset.records for c in r.compared))


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


def _name_channel(found: Diagnosis, channel: str) -> str:
    return found.units.word(channel) if channel in CHANNELS else channel


def _describe_cause(found: Diagnosis, step: CauseStep) -> str:
    sizes = ", ".join(
        f"{p.name} {format_quantity(number.value, number.unit, 3)}"
        for p in step.effect.parameters
        if (number := found.parameters.get(f"{step.effect.name}.{p.name}")) is not None
    )
    first = f"{step.effect.cause} ({step.effect.label}: {sizes})"
    rivals = [
        f"{effect.cause} ({name})"
        for name in step.rivals
        if name not in found.causes
        for effect in _find_effects(name)[:1]
    ]
    return " or ".join([first, *rivals])


def _list_length_parameters(found: Diagnosis) -> list[str]:
    """Return the parameters with a length in their unit."""
    told = TIP_COMPLIANCE.name if DISTAL_DISPLACEMENT in found.dataset.records[0].signals else ""
    return [
        name
        for name, one in found.parameters.items()
        if re.search(r"\b(?<!N )(m|rad)\b", one.unit) and not name.startswith(told or " ")
    ]


def _list_unsure_causes(found: Diagnosis) -> list[str]:
    """Return names of causes that would explain what no cause was surely found for."""
    if found.steps:
        return []
    names = [one.name for one in found.ranking if one.left < SETTINGS.explained]
    return list(dict.fromkeys(names))[:UNSURE_CAUSES_SHOWN]


def _find_effects(name: str) -> list[Effect]:
    return [effect for effect in CATALOGUE if effect.name == name]


def _describe_gain(found: Diagnosis) -> str:
    """Return the gain of the channel that was furthest off, counted in its noise."""

    def fall(channel: str) -> float:
        before, after = (model.held_out[channel].rmse for model in (found.before, found.after))
        return (before - after) / found.noise[channel]

    channel = max(found.gain, key=fall)
    most = found.gain[channel]
    causes = "that" if len(found.steps) == 1 else "them"
    return (
        f"with {causes} in the model the {name_judged_samples(found)} error of the "
        f"{found.units.word(channel)} falls by {most.value:.0%} "
        f"({most.low:.0%} to {most.high:.0%}), to {_compare_with_simple_model(found, channel)}"
    )


def _compare_with_simple_model(found: Diagnosis, channel: str) -> str:
    gain = found.simple_gain[channel]
    where = "below" if gain.value >= 0.0 else "above"
    return f"{abs(gain.value):.0%} {where} that of the best simple model ({gain.model})"


def _describe_dependence(found: Diagnosis) -> str:
    if not found.structure:
        return "residuals depend on none of the tested variables"
    parts = [
        f"{s.what} ({s.share:.0%} of its variance in the {found.units.word(s.channel)})"
        for s in found.structure[:DEPENDENCES_SHOWN]
    ]
    return "residuals depend on " + " and ".join(parts)


def _describe_detection_limits(sizes: dict[str, DetectionLimit]) -> str:
    if not sizes:
        return ""
    name, least = next(iter(sizes.items()))
    others = f", and {len(sizes) - 1} other effects from sizes listed below" * (len(sizes) > 1)
    size = format_quantity(least.size, least.unit, 2)
    return f"; {name} would have been seen from a {least.parameter} of {size} on{others}"


def _format_errors(
    found: Diagnosis, model: ModelErrors, name: str, channel: str
) -> tuple[str, ...]:
    one = getattr(model, name).get(channel)
    if one is None:
        return "", "", ""
    return (
        format_quantity(one.rmse, found.units.of(channel), 3),
        f"{one.largest:.2%}",
        f"{one.mean:.2%}",
    )
