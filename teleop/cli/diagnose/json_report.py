"""report.json: a diagnosis for programs, in SI units, and compared with a calibration.

Units are N and m, or N m and rad.
"""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from estimator.diagnosis import report_tables, report_text
from estimator.diagnosis.curve import describe_curve
from estimator.diagnosis.dataset import COMPLIANCE, FRICTION
from estimator.diagnosis.outcome import (
    Curve,
    Diagnosis,
    ErrorStatistics,
    FittedValue,
    ModelErrors,
    PredictedRecord,
    RankedCandidate,
)
from estimator.diagnosis.scoring import Choice
from estimator.effects.effect import Parameter, Values
from estimator.law.sheath import Sheath
from estimator.report_table import Table
from estimator.units import Units, format_quantity
from slave.calibration import calibration_file
from teleop.cli.html_page import to_json_values
from teleop.errors import UsageError


class ComparedParameter(NamedTuple):
    """A parameter of the sheath from calibration and data."""

    accepted: float
    found: FittedValue

    @property
    def agrees(self) -> bool:
        """Whether the calibration is inside the interval of the data."""
        return self.found.low <= self.accepted <= self.found.high


def load_sheath(path: Path, tendon: int) -> Sheath:
    """Return the sheath of a tendon, from 0, of a calibration file; a single one is for all."""
    tendons = calibration_file.load(path).tendons
    if len(tendons) > 1 and tendon >= len(tendons):
        raise UsageError(f"{path}: has {len(tendons)} tendons, not tendon {tendon + 1}")
    return tendons[tendon if len(tendons) > 1 else 0].build_model().sheath


def compare_parameters(diagnosis: Diagnosis, sheath: Sheath) -> dict[str, ComparedParameter]:
    """Return the parameters in both calibration and data, by name."""
    accepted = {FRICTION.name: sheath.K, COMPLIANCE.name: sheath.length / sheath.axial_stiffness}
    return {
        name: ComparedParameter(value, diagnosis.parameters[name])
        for name, value in accepted.items()
        if name in diagnosis.parameters
    }


def build_comparison_table(numbers: Mapping[str, ComparedParameter]) -> Table:
    """Return the comparison as text."""
    rows = [
        (
            name,
            format_quantity(comparison.accepted, comparison.found.unit),
            format_quantity(comparison.found.value, comparison.found.unit),
            report_tables.format_interval(comparison.found),
            "yes" if comparison.agrees else "NO",
        )
        for name, comparison in numbers.items()
    ]
    return Table(("sheath", "calibration", "these data", "95 % interval", "agree"), tuple(rows))


# --- report.json: a diagnosis for programs, in SI units, N and m or N m and rad


def build_report(
    diagnosis: Diagnosis,
    files: Sequence[str],
    seconds: float,
    accepted: Mapping[str, ComparedParameter],
    further: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the report; non-finite numbers are None.

    `files` and `further` are the names of the fitted files and of those for validation, `accepted`
    is the comparison with a calibration, by parameter.
    """
    names = report_tables.name_records(diagnosis, files, further)
    report = {
        "verdict": diagnosis.verdict.value,
        "headline": report_text.format_headline(diagnosis),
        "sentence": report_text.format_verdict(diagnosis),
        "units": {"effort": diagnosis.units.effort, "travel": diagnosis.units.travel},
        "closed_loop": diagnosis.dataset.records[0].loop,
        "law": _build_choice(diagnosis.laws, diagnosis.dataset.base.law),
        "loads": _build_choice(diagnosis.loads, diagnosis.dataset.base.loads),
        "cause": list(diagnosis.causes),
        "candidates": _build_candidates(diagnosis.ranking),
        "ambiguous_with": list(diagnosis.ambiguous_with),
        "steps": [
            {
                "name": step.effect.name,
                "label": step.effect.label,
                "file": names[step.effect.file - 1] if step.effect.file else None,
                "rivals": step.rivals,
                "candidates": _build_candidates(step.ranking),
            }
            for step in diagnosis.steps
        ],
        "parameters": diagnosis.parameters,
        "baseline": _build_fitness_sets(diagnosis.before),
        "extended": _build_fitness_sets(diagnosis.after),
        "simple_models": {item.name: item.rmse for item in diagnosis.simple_models},
        "fit_all": diagnosis.fit_all,
        "validation": _build_prediction_errors(diagnosis.validation, names[len(files) :]),
        "left_out": _build_prediction_errors(diagnosis.left_out, files),
        "forces": [
            {
                "file": name,
                "validation": item.validation,
                "before": item.before,
                "after": item.after,
            }
            for name, item in zip(names, diagnosis.forces, strict=False)
        ],
        "rivals": _build_rivals(diagnosis),
        "simple_gain": diagnosis.simple_gain,
        "learned_models": {item.name: item.rmse for item in diagnosis.learned_models},
        "learned_gain": diagnosis.learned_gain,
        "learned": report_text.compare_with_learned(diagnosis),
        "model_warnings": report_text.list_model_warnings(diagnosis),
        "live_error": diagnosis.live_error,
        "gain": diagnosis.gain,
        "noise": diagnosis.noise,
        "driver": {
            "channel": diagnosis.dataset.records[0].driver,
            "noise": [record.noise[record.driver] for record in diagnosis.dataset.records],
        },
        "left": diagnosis.residual_fraction,
        "has_drifting_friction": diagnosis.has_drifting_friction,
        "structure": diagnosis.residual_dependences,
        "function": _build_curve(diagnosis.curve, diagnosis.units),
        "detection_limits": diagnosis.detection_limits,
        "sheath": {
            name: {"accepted": item.accepted, "agrees": item.agrees}
            for name, item in accepted.items()
        },
        "experiments": list(diagnosis.experiments),
        "next": report_text.list_next_steps(diagnosis),
        "troubles": diagnosis.issues,
        "files": list(files),
        "samples": [int(record.measured.sum()) for record in diagnosis.dataset.records],
        "thinned": [record.decimation_factor for record in diagnosis.dataset.records],
        "seconds": seconds,
        "version": version("tendon-teleop"),
    }
    values: dict[str, Any] = to_json_values(report)
    return values


def _build_curve(curve: Curve | None, units: Units) -> dict[str, Any] | None:
    """Return the free function of the model, with its 95 % interval."""
    if curve is None or curve.effect.function is None:
        return None
    term = curve.effect.function
    return {
        "name": curve.effect.name,
        "changes": term.target,
        "variable": term.variable,
        "sentence": describe_curve(curve, units),
        "unit": units.name_unit(term.unit),
        "value_unit": units.name_unit(curve.unit),
        "period": curve.period,
        "x": curve.x,
        "value": curve.value,
        "low": curve.value - curve.half_width,
        "high": curve.value + curve.half_width,
    }


def _build_prediction_errors(
    records: Sequence[PredictedRecord], names: Sequence[str]
) -> list[dict[str, Any]]:
    """Return the errors of files that were not fitted."""
    return [
        {
            "file": name,
            "start": prediction.record.start,
            "end": prediction.record.start + float(prediction.record.time[-1]),
            "channels": {
                channel: {
                    "samples": int(prediction.record.valid[channel].sum()),
                    "spikes": prediction.spikes[channel],
                    "baseline": _build_fitness(before),
                    "extended": _build_fitness(prediction.fitness(prediction.after)[channel]),
                }
                for channel, before in prediction.fitness(prediction.before).items()
            },
        }
        for name, prediction in zip(names, records, strict=False)
    ]


def _build_rivals(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Return the models of equally good causes, and what they would do to the force."""
    forces = {(rival.replaces, rival.label): rival for rival in diagnosis.rival_forces}
    tree = []
    for rival in diagnosis.rivals:
        force = forces.get((rival.replaces, rival.effect.label))
        model = rival.fit.model
        tree.append(
            {
                "name": rival.effect.name,
                "label": rival.effect.label,
                "replaces": rival.replaces,
                "base": _name_values(diagnosis.dataset.base.shared, model.shared),
                "effects": {
                    effect.name: _name_values(effect.parameters, values)
                    for effect, values in model.effects
                },
                "force_change": force,
            }
        )
    return tree


def _name_values(parameters: Sequence[Parameter], values: Values) -> dict[str, float]:
    return {p.name: value for p, value in zip(parameters, values, strict=True)}


def _build_candidates(ranking: Sequence[RankedCandidate]) -> list[dict[str, Any]]:
    """Return the candidates of a search, the best first."""
    return [
        {
            "name": ranked.name,
            "label": ranked.label,
            "score": ranked.score,
            "held_out_rmse": ranked.rmse,
            "left": ranked.residual_fraction,
            "parameters": _name_values(ranked.effect.parameters, ranked.values),
        }
        for ranked in report_tables.select_best_candidates(ranking, len(ranking))
    ]


def _build_choice(choice: Choice, chosen: str) -> dict[str, Any]:
    """Return what was chosen, and the scores of all that could be."""
    return {
        "chosen": str(chosen),
        "alike": list(choice.equivalents) if len(choice.equivalents) > 1 else [],
        "scores": [
            {"name": score.name, "score": score.score, "held_out_rmse": score.rmse}
            for score in choice.scores
        ],
    }


def _build_fitness_sets(all_of: ModelErrors) -> dict[str, Any]:
    return {
        name: {
            channel: _build_fitness(statistics)
            for channel, statistics in getattr(all_of, name).items()
        }
        for name in report_tables.SAMPLE_SETS
    }


def _build_fitness(statistics: ErrorStatistics) -> dict[str, float]:
    return {
        "rmse": statistics.rmse,
        "max_percent": 100.0 * statistics.largest,
        "mean_percent": 100.0 * statistics.mean,
    }
