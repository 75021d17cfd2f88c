"""A diagnosis in words: the verdict in one sentence, tables of text, and what to do next."""

import re
from collections.abc import Iterable, Sequence

import numpy as np

from estimator.diagnosis import report_tables
from estimator.diagnosis.curve import describe_curve
from estimator.diagnosis.dataset import (
    TIP_COMPLIANCE,
    compute_tolerance,
)
from estimator.diagnosis.outcome import (
    CauseStep,
    Curve,
    DetectionLimit,
    Diagnosis,
    FittedValue,
    Verdict,
)
from estimator.diagnosis.report_tables import (
    build_detection_limit_table,
    build_gain_table,
    build_law_table,
    build_load_table,
    build_model_table,
    build_parameter_table,
    build_ranking_table,
    build_simple_gain_table,
    name_judged_samples,
)
from estimator.diagnosis.settings import SETTINGS
from estimator.diagnosis.simple_models import LUGRE
from estimator.effects import CATALOGUE, Effect, Parameter
from estimator.effects.effect import CHANNELS, DISTAL_DISPLACEMENT, DISTAL_TENSION, PROXIMAL_TENSION
from estimator.effects.functions import find_function
from estimator.report_table import Table
from estimator.units import format_quantity

DEPENDENCES_SHOWN = 2  # named in a sentence
UNSURE_CAUSES_SHOWN = 3  # causes in a sentence, none of them sure


def format_headline(diagnosis: Diagnosis) -> str:
    """Return the verdict in a few words, without names of the catalogue."""
    if diagnosis.foreign_reason:
        return f"This is not a tendon-sheath transmission: {diagnosis.foreign_reason}."
    if diagnosis.verdict is Verdict.CLEAN:
        return "Nothing is wrong beyond noise."
    if diagnosis.verdict is Verdict.CHARACTERISED and diagnosis.curve is not None:
        return f"No named cause: {describe_curve(diagnosis.curve, diagnosis.units)}."
    if diagnosis.verdict is Verdict.UNEXPLAINED:
        return "Something is wrong, and no cause explains it."
    causes = [f"{step.effect.cause}{_format_size(diagnosis, step)}" for step in diagnosis.steps]
    count = ("One thing is", "Two things are", "Three things are")[min(len(causes), 3) - 1]
    ambiguity = ", or what looks the same" * (diagnosis.verdict is Verdict.AMBIGUOUS)
    return f"{count} wrong: {', and '.join(causes)}{ambiguity}."


def _format_size(diagnosis: Diagnosis, step: CauseStep) -> str:
    """Return the first size of a cause in brackets, if it has one."""
    for p, (value, _, _, unit, _) in _collect_sizes(diagnosis, step):
        if p.neutral is not None:
            size = format_quantity(value, unit, 2) if unit else f"{100.0 * value:.3g} %"
            return f" ({size})"
    return ""


def _collect_sizes(diagnosis: Diagnosis, step: CauseStep) -> list[tuple[Parameter, FittedValue]]:
    """Return the numbers of a cause that were fitted."""
    names = {f"{step.effect.name}.{p.name}": p for p in step.effect.parameters}
    found = diagnosis.parameters
    return [(p, found[name]) for name, p in names.items() if name in found]


def describe_size(diagnosis: Diagnosis, step: CauseStep) -> str:
    """Return the numbers of a cause with their intervals, or where its curve goes."""
    if step.effect.function is not None and diagnosis.curve is not None:
        return describe_curve(diagnosis.curve, diagnosis.units)
    return "; ".join(
        f"{p.name} {format_quantity(number.value, number.unit, 3)} "
        f"({report_tables.format_interval(number)})"
        for p, number in _collect_sizes(diagnosis, step)
    )


def list_rivals(step: CauseStep) -> list[str]:
    """Return what else explains as much as a cause, in words."""
    return [f"{e.cause} ({e.label})" for e in _find_effects(step.rivals)]


def format_verdict(diagnosis: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    if diagnosis.verdict is Verdict.CLEAN:
        smallest = _describe_detection_limits(diagnosis.detection_limits)
        return f"Nothing is wrong with the model beyond noise{smallest}."
    if diagnosis.foreign_reason:
        return (
            f"This is not a tendon-sheath transmission, or the columns are not what they are taken "
            f"for: {diagnosis.foreign_reason}; {_describe_dependence(diagnosis)}."
        )
    if diagnosis.verdict is Verdict.UNEXPLAINED:
        if diagnosis.has_drifting_friction:
            labels = " and ".join(step.effect.label for step in diagnosis.steps)
            return (
                f"The model is wrong, and nothing in the catalogue explains it: friction changes "
                f"with time, and {labels} is only the closest match in the catalogue."
            )
        if names := _list_unsure_causes(diagnosis):
            return (
                f"The model is wrong, and these data do not determine the cause: "
                f"{' or '.join(names)} would explain it, none of them surely; "
                f"{_describe_dependence(diagnosis)}."
            )
        labels = " and ".join(step.effect.label for step in diagnosis.steps)
        share = f"{diagnosis.residual_fraction:.0%} of what noise does not explain"
        remainder = f"with {labels} in the model {share} is left, and " if diagnosis.steps else ""
        return (
            f"The model is wrong, and nothing in the catalogue explains it: {remainder}"
            f"{_describe_dependence(diagnosis)}."
        )
    if diagnosis.verdict is Verdict.CHARACTERISED and diagnosis.curve is not None:
        return _describe_function(diagnosis, diagnosis.curve)
    causes = " and ".join(f"because {_describe_cause(diagnosis, step)}" for step in diagnosis.steps)
    ambiguity = "; these channels cannot tell which" * (diagnosis.verdict is Verdict.AMBIGUOUS)
    return f"The model is wrong {causes}{ambiguity}; {_describe_gain(diagnosis)}."


def format_summary(
    diagnosis: Diagnosis,
    files: Sequence[str] = (),
    compared: Table | None = None,
    further: Sequence[str] = (),
) -> str:
    """Return all that is said of a diagnosis: headline, verdict, tables, residuals, next steps.

    Parameters
    ----------
    files : sequence of str, optional
        What the records are called; "record 1" and so on by default.
    compared : Table, optional
        A calibration beside what the data say.
    further : sequence of str, optional
        What the records for validation are called.
    """
    names = report_tables.name_records(diagnosis, files, further)
    lines = [format_verdict(diagnosis)]
    if file := max((step.effect.file for step in diagnosis.steps), default=0):
        lines.append(f"File {file} is {names[file - 1]}; the others do without it.")
    lines += [f"WARNING: {line}" for line in list_model_warnings(diagnosis)]
    parts = [format_headline(diagnosis), "\n".join(lines)]
    parts += [table.to_markdown() for table in build_tables(diagnosis, files, compared, further)]
    remains = [*describe_residuals(diagnosis), *compare_with_learned(diagnosis)]
    parts.append("Residuals:\n" + "\n".join(f"- {line}" for line in remains))
    parts.append("Next:\n" + "\n".join(f"- {step}" for step in list_next_steps(diagnosis)))
    if remarks := list_sample_remarks(diagnosis, names[: len(diagnosis.dataset.records)]):
        parts.append("Samples:\n" + "\n".join(f"- {remark}" for remark in remarks))
    return "\n\n".join(parts)


def build_tables(
    diagnosis: Diagnosis,
    files: Sequence[str] = (),
    compared: Table | None = None,
    further: Sequence[str] = (),
) -> list[Table]:
    """Return the tables of a diagnosis; for the parameters see `format_summary`."""
    names = report_tables.name_records(diagnosis, files, further)
    fitted_names = names[: len(diagnosis.dataset.records)]
    tables = [build_ranking_table(diagnosis, diagnosis.ranking)] if diagnosis.ranking else []
    tables.append(build_parameter_table(diagnosis))
    optional = (build_law_table(diagnosis), build_load_table(diagnosis), compared)
    tables += [table for table in optional if table is not None]
    if diagnosis.steps:
        tables.append(build_gain_table(diagnosis))
    tables += [build_model_table(diagnosis), build_simple_gain_table(diagnosis)]
    if diagnosis.validation:
        tables.append(
            report_tables.build_prediction_table(diagnosis.validation, names[len(fitted_names) :])
        )
    if diagnosis.left_out:
        left_out = [f"{name}, left out" for name in fitted_names]
        tables.append(report_tables.build_prediction_table(diagnosis.left_out, left_out))
    if diagnosis.forces:
        tables.append(report_tables.build_force_table(diagnosis, names))
    if diagnosis.rival_forces:
        tables.append(report_tables.build_rival_table(diagnosis))
    if diagnosis.detection_limits:
        tables.append(build_detection_limit_table(diagnosis))
    return tables


def list_model_warnings(diagnosis: Diagnosis) -> list[str]:
    """Return whether the model is of no use live, and where one without a sheath is better."""
    warnings, tolerance = [], compute_tolerance(diagnosis.dataset)
    error = diagnosis.live_error
    if error is not None and diagnosis.has_idle_function:
        warnings.append(f"{error.describe()}: `model.yaml` has the plain law and its own K.")
    elif error is not None and error.is_worse:
        warnings.append(f"{error.describe()}: `--model` refuses it.")
    for channel, gain in diagnosis.simple_gain.items():
        errors, noise = diagnosis.after.held_out[channel], diagnosis.noise[channel]
        if gain.high < 0.0 and errors.rmse > SETTINGS.noise_ratio * tolerance[channel] * noise:
            simple_model = next(m for m in diagnosis.simple_models if m.name == gain.model)
            unit = diagnosis.units.get_unit(channel)
            warnings.append(
                f"{diagnosis.units.name_channel(channel)}: {gain.model} predicts it better than "
                f"this model, {format_quantity(simple_model.rmse[channel], unit, 3)} against "
                f"{format_quantity(errors.rmse, unit, 3)} "
                f"{name_judged_samples(diagnosis)} RMSE; {_suggest_remedy(diagnosis, gain.model)}."
            )
    return warnings


def _suggest_remedy(diagnosis: Diagnosis, model: str) -> str:
    """Return what to do where a simple model is better than the law."""
    similar = ("presliding", "stribeck_friction") if model == LUGRE else ("distributed_play",)
    missing = [name for name in similar if name not in diagnosis.causes]
    if missing and DISTAL_TENSION in diagnosis.dataset.records[0].signals:
        requested = ",".join([*diagnosis.causes, *missing])
        return f"test the effect that is like it, with --effects {requested}"
    return "do not trust the estimate beyond that error, and look at what the residuals depend on"


def list_next_steps(diagnosis: Diagnosis) -> list[str]:
    """Return what a person does next, most useful first."""
    steps = [f"To tell the causes apart: {experiment}." for experiment in diagnosis.experiments]
    effects = [step.effect for step in diagnosis.steps] + _find_effects(diagnosis.ambiguous_with)
    advice = {effect.advice: effect.name for effect in reversed(effects)}
    steps += [f"{name}: {advice_text}" for advice_text, name in reversed(advice.items())]
    if diagnosis.dataset.records[0].driver == PROXIMAL_TENSION and (
        length_parameters := _list_length_parameters(diagnosis)
    ):
        units, motor = diagnosis.units, "angle" if diagnosis.units.rotary else "travel"
        assumed = SETTINGS.assumed_compliance * diagnosis.scale.size("m/N")
        steps.append(
            f"Record the motor's {motor}: without it {', '.join(length_parameters)} "
            f"hold for an L/EA of {format_quantity(assumed, units.name_unit('m/N'))} only."
        )
    if diagnosis.verdict is Verdict.UNEXPLAINED and _list_unsure_causes(diagnosis):
        steps.append(
            "Record for longer, with swings of several depths and speeds, so that a cause can be "
            "told in one part of the data and tested in another."
        )
    elif diagnosis.verdict is Verdict.UNEXPLAINED:
        steps.append(
            "Look at what is left against tension, speed and time, and do not trust the estimate "
            "beyond it; a cause that the catalogue lacks is an effect to add to it."
        )
    if diagnosis.untried:
        untried = ", ".join(dict.fromkeys(diagnosis.untried))
        steps.append(f"Not tried within the time limit: {untried}. --time-limit sets a longer one.")
    return steps or ["Use the model as it is."]


def list_sample_remarks(diagnosis: Diagnosis, files: Sequence[str]) -> list[str]:
    """Return which samples were excluded, averaged, or are odd."""
    remarks = []
    names = {channel: diagnosis.units.name_channel(channel) for channel in CHANNELS}
    for file, record in zip(files, diagnosis.dataset.records, strict=True):
        remarks += [
            f"{file}: {issue.samples} {issue.what} "
            f"({names.get(issue.channel, issue.channel)}), the first at {issue.first:.4g} s"
            for issue in record.issues
        ]
        if record.decimation_factor > 1:
            remarks.append(
                f"{file}: each {record.decimation_factor} samples were averaged to one; what "
                "happens faster is not seen"
            )
    return remarks


def describe_residuals(diagnosis: Diagnosis) -> list[str]:
    """Return what the extended model leaves in each channel, and what that depends on."""
    lines, tolerance = [], compute_tolerance(diagnosis.dataset)
    for channel, errors in diagnosis.after.held_out.items():
        unit, noise = diagnosis.units.get_unit(channel), diagnosis.noise[channel]
        dependences = [
            f"{dependence.what} ({dependence.share:.0%} of its variance)"
            for dependence in diagnosis.residual_dependences
            if dependence.channel == channel
        ]
        if errors.rmse < SETTINGS.noise_ratio * tolerance[channel] * noise:
            remark = "no more than noise and the simulation's own error"
        elif dependences:
            remark = f"the residual depends on {', '.join(dependences)}"
        else:
            remark = "it depends on no tension, speed, direction, travel or time"
        lines.append(
            f"{diagnosis.units.name_channel(channel)}: {format_quantity(errors.rmse, unit, 3)} "
            f"{name_judged_samples(diagnosis)} RMSE, "
            f"noise is {format_quantity(noise, unit, 2)}; {remark}."
        )
    return lines


def compare_with_learned(diagnosis: Diagnosis) -> list[str]:
    """Return whether a learned model finds more in each channel than the law, or what it needs."""
    if diagnosis.fit_all:
        return []
    if not diagnosis.learned_models:
        install = "pip install 'tendon-teleop[learned]'"
        return [f"To see whether a learned model would find more: {install}."]
    lines, tolerance = [], compute_tolerance(diagnosis.dataset)
    for channel, gain in diagnosis.learned_gain.items():
        errors, noise = diagnosis.after.held_out[channel], diagnosis.noise[channel]
        if all(float(np.ptp(r.signals[channel])) < 10.0 * noise for r in diagnosis.dataset.records):
            continue  # hardly moves
        least, unit = (
            min(model.rmse[channel] for model in diagnosis.learned_models),
            diagnosis.units.get_unit(channel),
        )
        learned, law = (format_quantity(rmse, unit, 3) for rmse in (least, errors.rmse))
        result = "nothing more to find from these inputs"
        is_beyond_noise = errors.rmse > SETTINGS.noise_ratio * tolerance[channel] * noise
        if gain.low > SETTINGS.learned_gain_min and is_beyond_noise:
            result = f"something is missing ({gain.low:.0%} to {gain.high:.0%} less)"
        lines.append(
            f"{diagnosis.units.name_channel(channel)}: a learned model leaves {learned}, "
            f"this law {law}: {result}."
        )
    return lines


def _describe_cause(diagnosis: Diagnosis, step: CauseStep) -> str:
    sizes = ", ".join(
        f"{p.name} {format_quantity(number.value, number.unit, 3)}"
        for p, number in _collect_sizes(diagnosis, step)
    )
    cause_text = f"{step.effect.cause} ({step.effect.label}: {sizes})"
    rivals = _find_effects(name for name in step.rivals if name not in diagnosis.causes)
    return " or ".join([cause_text, *(f"{rival.cause} ({rival.name})" for rival in rivals)])


def _describe_function(diagnosis: Diagnosis, curve: Curve) -> str:
    *named, step = diagnosis.steps
    beside = "".join(f" beside {item.effect.label}" for item in named)
    rivals = [effect.cause for effect in _find_effects(step.rivals)]
    alternatives = f"; or {' or '.join(rivals)}" if rivals else ""
    return (
        f"No named cause explains the error{beside}; {describe_curve(curve, diagnosis.units)}, "
        f"which explains {1.0 - diagnosis.residual_fraction:.0%} of the error beyond "
        f"noise{alternatives}."
    )


def _list_length_parameters(diagnosis: Diagnosis) -> list[str]:
    """Return the parameters with a length in their unit."""
    known_parameter = (
        TIP_COMPLIANCE.name if DISTAL_DISPLACEMENT in diagnosis.dataset.records[0].signals else ""
    )
    return [
        name
        for name, number in diagnosis.parameters.items()
        if re.search(r"\b(?<!N )(m|rad)\b", number.unit)
        and not name.startswith(known_parameter or " ")
    ]


def _list_unsure_causes(diagnosis: Diagnosis) -> list[str]:
    """Return names of causes that would explain what no cause was surely found for."""
    if diagnosis.steps:
        return []
    names = [
        candidate.name
        for candidate in diagnosis.ranking
        if candidate.residual_fraction < SETTINGS.unexplained_fraction_max
    ]
    return list(dict.fromkeys(names))[:UNSURE_CAUSES_SHOWN]


def _find_effects(names: Iterable[str]) -> list[Effect]:
    """Return the first effect of each of some names that has one."""
    named = {effect.name: effect for effect in reversed(CATALOGUE)}
    effects = [find_function(name) or named.get(name) for name in names]
    return [effect for effect in effects if effect is not None]


def _describe_gain(diagnosis: Diagnosis) -> str:
    """Return the gain of the channel that was furthest off, counted in its noise."""

    def compute_reduction(channel: str) -> float:
        before, after = (
            model.held_out[channel].rmse for model in (diagnosis.before, diagnosis.after)
        )
        return (before - after) / diagnosis.noise[channel]

    channel = max(diagnosis.gain, key=compute_reduction)
    largest_gain = diagnosis.gain[channel]
    causes = "that" if len(diagnosis.steps) == 1 else "them"
    return (
        f"with {causes} in the model the {name_judged_samples(diagnosis)} error of the "
        f"{diagnosis.units.name_channel(channel)} falls by {largest_gain.value:.0%} "
        f"({largest_gain.low:.0%} to {largest_gain.high:.0%}), to "
        f"{_compare_with_simple_model(diagnosis, channel)}"
    )


def _compare_with_simple_model(diagnosis: Diagnosis, channel: str) -> str:
    gain = diagnosis.simple_gain[channel]
    relation = "below" if gain.value >= 0.0 else "above"
    return f"{abs(gain.value):.0%} {relation} that of the best simple model ({gain.model})"


def _describe_dependence(diagnosis: Diagnosis) -> str:
    if not diagnosis.residual_dependences:
        return "residuals depend on none of the tested variables"
    parts = [
        f"{dependence.what} ({dependence.share:.0%} of its variance in the "
        f"{diagnosis.units.name_channel(dependence.channel)})"
        for dependence in diagnosis.residual_dependences[:DEPENDENCES_SHOWN]
    ]
    return "residuals depend on " + " and ".join(parts)


def _describe_detection_limits(sizes: dict[str, DetectionLimit]) -> str:
    if not sizes:
        return ""
    name, limit = next(iter(sizes.items()))
    other_text = f", and {len(sizes) - 1} other effects from sizes listed below" * (len(sizes) > 1)
    size = format_quantity(limit.size, limit.unit, 2)
    return f"; {name} would have been seen from a {limit.parameter} of {size} on{other_text}"
