"""Text report of a study of a pair."""

import math

import numpy as np

from estimator.pair.pair_fit import PairVariant
from estimator.pair.pair_structure import analyse_residuals, compute_offset_share
from estimator.pair.pair_study import (
    HeldOutError,
    Number,
    PairStudy,
    Validation,
    compute_mean_share,
)
from estimator.text_table import Table

OWN_METHOD = PairVariant.FULL.value
DEPENDENCE_MIN = 0.02  # of the span: larger means count as a dependence


def format_sentence(found: PairStudy) -> str:
    """Return the result in one sentence."""
    share = compute_mean_share(found.left_out[OWN_METHOD])
    return (
        f"K grows by {format_interval(found.growth)} per radian of bend, from "
        f"{found.friction.value:.2f} at "
        f"none; bends that were not fitted are predicted within {share:.1%} of the angle's span "
        f"({format_degrees(compute_mean_rmse(found.left_out[OWN_METHOD]))}), where one K for "
        f"all leaves "
        f"{compute_mean_share(found.left_out[PairVariant.ONE_K.value]):.1%} and the best model "
        f"without "
        f"tendons ({found.best_simple}) "
        f"{compute_mean_share(found.left_out[found.best_simple]):.1%}."
    )


def format_model_warning(found: PairStudy) -> list[str]:
    """Return a warning if a model without tendons predicts bends that were not fitted better."""
    simple, ours = (
        compute_mean_share(found.left_out[name]) for name in (found.best_simple, OWN_METHOD)
    )
    if simple >= ours:
        return []
    return [
        f"WARNING: {found.best_simple} predicts bends that were not fitted better than this model, "
        f"{simple:.1%} against {ours:.1%} of the span; check the zero of the angle in each file, "
        "and add bends between those that were measured."
    ]


def build_friction_table(found: PairStudy) -> Table:
    """Return K of each record and of the linear model."""
    model = found.fit.model
    rows = tuple(
        (
            format_degrees(record.bend, 0),
            format_interval(K),
            f"{model.friction_at(record.bend):.2f}",
            format_degrees(neutral),
        )
        for record, K, neutral in zip(found.records, found.each, found.fit.neutrals, strict=True)
    )
    return Table(("bend", "K (95 %)", "K0 + mu bend", "neutral angle"), rows)


def build_parameter_table(found: PairStudy) -> Table:
    """Return the numbers of the model for all records."""
    model = found.fit.model
    degree = math.radians(1.0)
    rows = (
        (
            "K0",
            format_interval(found.friction),
            "friction of the straight sheath with its bending section",
        ),
        ("mu", f"{format_interval(found.growth)} 1/rad", "growth of K with the bend"),
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


def build_held_out_table(found: PairStudy) -> Table:
    """Return the errors of held-out records."""
    head = ("angle predicted by", *(format_degrees(r.bend, 0) for r in found.records), "mean")
    rows = []
    for method, errors in found.left_out.items():
        cells = (f"{format_degrees(e.rmse)} {e.share:.1%}" for e in errors)
        mean = f"{format_degrees(compute_mean_rmse(errors))} {compute_mean_share(errors):.1%}"
        rows.append((method, *cells, mean))
    zeroed = found.left_out[OWN_METHOD]
    rows.append(
        (
            "K grows, from the command, its zero known",
            *(f"{e.zeroed:.1%}" for e in zeroed),
            f"{np.mean([e.zeroed for e in zeroed]):.1%}",
        )
    )
    return Table(head, tuple(rows))


def build_validation_table(kept: tuple[Validation, ...]) -> Table:
    """Return the errors of validation records."""
    rows = tuple(
        (
            format_degrees(one.bend, 0),
            f"{format_degrees(one.ours.rmse)} {one.ours.share:.1%}",
            f"{one.ours.zeroed:.1%}",
            *(f"{format_degrees(e.rmse)} {e.share:.1%}" for e in one.baselines.values()),
        )
        for one in kept
    )
    head = ("bend kept apart", "predicted by the model", "its zero known", *kept[0].baselines)
    return Table(head, rows)


def build_residual_table(found: PairStudy) -> Table:
    """Return the residuals of held-out records, by dependence."""
    rows = tuple(
        (part.what, f"{part.mean:+.1%}", f"{part.rms:.1%}")
        for part in analyse_residuals(found.records, found.predicted)
    )
    return Table(("samples in which", "mean", "RMS"), rows)


def describe_errors(found: PairStudy) -> list[str]:
    """Return the errors of the model as text."""
    records, errors = found.records, found.left_out[OWN_METHOD]
    worst = max(range(len(errors)), key=lambda i: errors[i].share)
    share = compute_offset_share(records, found.predicted)
    lines = [
        f"Worst is the bend of {format_degrees(records[worst].bend, 0)}: "
        f"{errors[worst].share:.1%} of the "
        f"span, {errors[worst].zeroed:.1%} if its zero were known.",
        f"{share:.0%} of the mean square is a constant of each record: a joint with friction rests "
        "anywhere in a band when its sensor is zeroed, and the command does not tell where.",
    ]
    found_parts = analyse_residuals(records, found.predicted)
    along = sorted(found_parts, key=lambda part: -abs(part.mean))
    lines += [
        f"Where the {part.what}, the prediction is {abs(part.mean):.1%} of the span too "
        f"{'high' if part.mean > 0.0 else 'low'} on average."
        for part in along
        if abs(part.mean) > DEPENDENCE_MIN
    ]
    if all(abs(part.mean) <= DEPENDENCE_MIN for part in found_parts):
        lines.append(
            "The rest of the residual depends on direction, command and time by less than "
            f"{DEPENDENCE_MIN:.0%} of the span."
        )
    return lines


def build_report_tables(found: PairStudy) -> list[Table]:
    """Return the tables of a study."""
    shown = [
        build_friction_table(found),
        build_parameter_table(found),
        build_held_out_table(found),
        build_residual_table(found),
    ]
    if found.validation:
        shown.insert(3, build_validation_table(found.validation))
    return shown


def format_report(found: PairStudy) -> str:
    """Return the report for a terminal."""
    said = "\n".join([format_sentence(found), *format_model_warning(found)])
    pieces = [said, *(table.markdown() for table in build_report_tables(found))]
    pieces.append("What is wrong:\n" + "\n".join(f"- {line}" for line in describe_errors(found)))
    return "\n\n".join(pieces)


def format_interval(number: Number) -> str:
    """Return a number with its interval."""
    return f"{number.value:.2f} ({number.low:.2f} to {number.high:.2f})"


def format_degrees(angle: float, digits: int = 1) -> str:
    """Return an angle [rad] as text."""
    return f"{math.degrees(angle):.{digits}f}°"


def compute_mean_rmse(errors: tuple[HeldOutError, ...]) -> float:
    """Return the mean RMSE [rad]."""
    return float(np.mean([error.rmse for error in errors]))
