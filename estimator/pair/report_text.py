"""Text report of a study of a pair."""

import math

import numpy as np

from estimator.fitting import IntervalEstimate
from estimator.pair.pair_fit import PairVariant
from estimator.pair.pair_study import (
    HeldOutError,
    PairStudy,
    Validation,
    analyse_residuals,
    compute_mean_share,
    compute_offset_share,
)
from estimator.report_table import Table

OWN_METHOD = PairVariant.FULL.value
DEPENDENCE_MIN = 0.02  # of the span: larger means count as a dependence


def format_sentence(study: PairStudy) -> str:
    """Return the result in one sentence."""
    methods = (OWN_METHOD, PairVariant.ONE_K.value, study.best_simple)
    share, one_K, simple = (compute_mean_share(study.left_out[method]) for method in methods)
    rmse = compute_mean_rmse(study.left_out[OWN_METHOD])
    return (
        f"K grows by {format_interval(study.growth)} per radian of bend, from "
        f"{study.friction.value:.2f} at none; bends that were not fitted are predicted within "
        f"{share:.1%} of the angle's span ({format_degrees(rmse)}), where one K for all leaves "
        f"{one_K:.1%} and the best model without tendons ({study.best_simple}) {simple:.1%}."
    )


def format_model_warning(study: PairStudy) -> list[str]:
    """Return a warning if a model without tendons predicts bends that were not fitted better."""
    simple_share, own_share = (
        compute_mean_share(study.left_out[name]) for name in (study.best_simple, OWN_METHOD)
    )
    if simple_share >= own_share:
        return []
    return [
        f"WARNING: {study.best_simple} predicts bends that were not fitted better than this model, "
        f"{simple_share:.1%} against {own_share:.1%} of the span; check the zero of the angle in "
        "each file, and add bends between those that were measured."
    ]


def build_friction_table(study: PairStudy) -> Table:
    """Return K of each record and of the linear model."""
    model = study.fit.model
    rows = tuple(
        (
            format_degrees(record.bend, 0),
            format_interval(K),
            f"{model.compute_friction(record.bend):.2f}",
            format_degrees(neutral),
        )
        for record, K, neutral in zip(
            study.records, study.record_frictions, study.fit.neutrals, strict=True
        )
    )
    return Table(("bend", "K (95 %)", "K0 + mu bend", "neutral angle"), rows)


def build_parameter_table(study: PairStudy) -> Table:
    """Return the numbers of the model for all records."""
    model = study.fit.model
    degree = math.radians(1.0)
    rows = (
        (
            "K0",
            format_interval(study.friction),
            "friction of the straight sheath with its bending section",
        ),
        ("mu", f"{format_interval(study.growth)} 1/rad", "growth of K with the bend"),
        (
            "compliance",
            f"{model.compliance / degree:.1f} deg/N",
            "command per newton, without friction",
        ),
        ("bedding", f"{model.bedding:.1f} N", "tendons are soft at small tensions"),
        ("stiffness", f"{model.stiffness * degree:.3f} N/deg", "of the joint"),
        ("joint friction", f"{model.joint_friction:.2f} N", "between the tendons' tips"),
        (
            "neutral angle",
            format_degrees(model.neutral),
            "mean; between two bends it is interpolated",
        ),
    )
    return Table(("parameter", "value", "what it is"), rows)


def build_held_out_table(study: PairStudy) -> Table:
    """Return the errors of held-out records."""
    head = ("angle predicted by", *(format_degrees(r.bend, 0) for r in study.records), "mean")
    rows = []
    for method, errors in study.left_out.items():
        cells = (f"{format_degrees(e.rmse)} {e.share:.1%}" for e in errors)
        mean = f"{format_degrees(compute_mean_rmse(errors))} {compute_mean_share(errors):.1%}"
        rows.append((method, *cells, mean))
    zeroed = study.left_out[OWN_METHOD]
    rows.append(
        (
            "K grows, from the command, its zero known",
            *(f"{e.zeroed:.1%}" for e in zeroed),
            f"{np.mean([e.zeroed for e in zeroed]):.1%}",
        )
    )
    return Table(head, tuple(rows))


def build_validation_table(validations: tuple[Validation, ...]) -> Table:
    """Return the errors of validation records."""
    rows = tuple(
        (
            format_degrees(validation.bend, 0),
            f"{format_degrees(validation.model_error.rmse)} {validation.model_error.share:.1%}",
            f"{validation.model_error.zeroed:.1%}",
            *(f"{format_degrees(e.rmse)} {e.share:.1%}" for e in validation.baselines.values()),
        )
        for validation in validations
    )
    head = ("bend kept apart", "predicted by the model", "its zero known")
    return Table((*head, *validations[0].baselines), rows)


def build_residual_table(study: PairStudy) -> Table:
    """Return the residuals of held-out records, by dependence."""
    rows = tuple(
        (part.what, f"{part.mean:+.1%}", f"{part.rms:.1%}")
        for part in analyse_residuals(study.records, study.predicted)
    )
    return Table(("samples in which", "mean", "RMS"), rows)


def describe_errors(study: PairStudy) -> list[str]:
    """Return the errors of the model as text."""
    records, errors = study.records, study.left_out[OWN_METHOD]
    worst = max(range(len(errors)), key=lambda i: errors[i].share)
    share = compute_offset_share(records, study.predicted)
    lines = [
        f"Worst is the bend of {format_degrees(records[worst].bend, 0)}: {errors[worst].share:.1%} "
        f"of the span, {errors[worst].zeroed:.1%} if its zero were known.",
        f"{share:.0%} of the mean square is a constant of each record: a joint with friction rests "
        "anywhere in a band when its sensor is zeroed, and the command does not tell where.",
    ]
    parts = analyse_residuals(records, study.predicted)
    ordered_parts = sorted(parts, key=lambda part: -abs(part.mean))
    lines += [
        f"Where the {part.what}, the prediction is {abs(part.mean):.1%} of the span too "
        f"{'high' if part.mean > 0.0 else 'low'} on average."
        for part in ordered_parts
        if abs(part.mean) > DEPENDENCE_MIN
    ]
    if all(abs(part.mean) <= DEPENDENCE_MIN for part in parts):
        lines.append(
            "The rest of the residual depends on direction, command and time by less than "
            f"{DEPENDENCE_MIN:.0%} of the span."
        )
    return lines


def build_report_tables(study: PairStudy) -> list[Table]:
    """Return the tables of a study."""
    tables = [
        build_friction_table(study),
        build_parameter_table(study),
        build_held_out_table(study),
        build_residual_table(study),
    ]
    if study.validation:
        tables.insert(3, build_validation_table(study.validation))
    return tables


def format_report(study: PairStudy) -> str:
    """Return the report for a terminal."""
    summary = "\n".join([format_sentence(study), *format_model_warning(study)])
    pieces = [summary, *(table.to_markdown() for table in build_report_tables(study))]
    pieces.append("What is wrong:\n" + "\n".join(f"- {line}" for line in describe_errors(study)))
    return "\n\n".join(pieces)


def format_interval(number: IntervalEstimate) -> str:
    """Return a number with its interval."""
    return f"{number.value:.2f} ({number.low:.2f} to {number.high:.2f})"


def format_degrees(angle: float, digits: int = 1) -> str:
    """Return an angle [rad] as text."""
    return f"{math.degrees(angle):.{digits}f}°"


def compute_mean_rmse(errors: tuple[HeldOutError, ...]) -> float:
    """Return the mean RMSE [rad]."""
    return float(np.mean([error.rmse for error in errors]))
