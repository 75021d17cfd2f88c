"""report.json: a diagnosis for programs, in SI units, and compared with a calibration.

Units are N and m, or N m and rad.
"""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from estimator.diagnosis import report_tables, report_text
from estimator.diagnosis.dataset import COMPLIANCE, FRICTION
from estimator.diagnosis.outcome import (
    Diagnosis,
    ErrorStatistics,
    FittedValue,
    ModelErrors,
    PredictedRecord,
    RankedCandidate,
)
from estimator.diagnosis.scoring import Choice
from estimator.law.sheath import Sheath
from estimator.text_table import Table
from estimator.units import format_quantity
from slave.calibration import file
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
    tendons = file.load(path).tendons
    if len(tendons) > 1 and tendon >= len(tendons):
        raise UsageError(f"{path}: has {len(tendons)} tendons, not tendon {tendon + 1}")
    return tendons[tendon if len(tendons) > 1 else 0].model().sheath


def compare_parameters(found: Diagnosis, sheath: Sheath) -> dict[str, ComparedParameter]:
    """Return the parameters in both calibration and data, by name."""
    accepted = {
        FRICTION.name: sheath.K,
        COMPLIANCE.name: sheath.length / sheath.axial_stiffness,
    }
    return {
        name: ComparedParameter(value, found.parameters[name])
        for name, value in accepted.items()
        if name in found.parameters
    }


def build_comparison_table(numbers: Mapping[str, ComparedParameter]) -> Table:
    """Return the comparison as text."""
    rows = [
        (
            name,
            format_quantity(one.accepted, one.found.unit),
            format_quantity(one.found.value, one.found.unit),
            report_tables.format_interval(one.found),
            "yes" if one.agrees else "NO",
        )
        for name, one in numbers.items()
    ]
    return Table(("sheath", "calibration", "these data", "95 % interval", "agree"), tuple(rows))


# --- report.json: a diagnosis for programs, in SI units, N and m or N m and rad


def build_report(
    found: Diagnosis,
    files: Sequence[str],
    seconds: float,
    accepted: Mapping[str, ComparedParameter],
    further: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the report; non-finite numbers are None.

    Parameters
    ----------
    found : Diagnosis
    files : sequence of str
        Names of the data files.
    seconds : float
        Duration of the diagnosis.
    accepted : mapping
        Comparison with a calibration, by parameter.
    further : sequence of str
        Names of the files for validation.
    """
    names = report_tables.name_records(found, files, further)
    report = {
        "verdict": found.verdict.value,
        "sentence": report_text.format_verdict(found),
        "units": {"effort": found.units.effort, "travel": found.units.travel},
        "closed_loop": found.dataset.records[0].loop,
        "law": _build_choice(found.laws, found.dataset.base.law),
        "loads": _build_choice(found.loads, found.dataset.base.loads),
        "cause": list(found.causes),
        "candidates": _build_candidates(found.ranking),
        "ambiguous_with": list(found.ambiguous_with),
        "steps": [
            {
                "name": step.effect.name,
                "label": step.effect.label,
                "rivals": step.rivals,
                "candidates": _build_candidates(step.ranking),
            }
            for step in found.steps
        ],
        "parameters": {name: number._asdict() for name, number in found.parameters.items()},
        "baseline": _build_fitness_sets(found.before),
        "extended": _build_fitness_sets(found.after),
        "simple_models": {one.name: one.rmse for one in found.simple_models},
        "fit_all": found.fit_all,
        "validation": _build_prediction_errors(found.validation, names[len(files) :]),
        "left_out": _build_prediction_errors(found.left_out, files),
        "forces": [
            {"file": name, "validation": one.validation}
            | {"before": one.before._asdict(), "after": one.after._asdict()}
            for name, one in zip(names, found.forces, strict=False)
        ],
        "rivals": _build_rivals(found),
        "simple_gain": {channel: gain._asdict() for channel, gain in found.simple_gain.items()},
        "better_models": report_text.list_better_models(found),
        "gain": {channel: gain._asdict() for channel, gain in found.gain.items()},
        "noise": dict(found.noise),
        "driver": {
            "channel": found.dataset.records[0].driver,
            "noise": [record.noise[record.driver] for record in found.dataset.records],
        },
        "left": found.residual_fraction,
        "wanders": found.has_drifting_friction,
        "structure": [one._asdict() for one in found.residual_dependences],
        "detection_limits": {
            name: least._asdict() for name, least in found.detection_limits.items()
        },
        "sheath": {
            name: {"accepted": one.accepted, "agrees": one.agrees} for name, one in accepted.items()
        },
        "experiments": list(found.experiments),
        "next": report_text.list_next_steps(found),
        "troubles": [trouble._asdict() for trouble in found.issues],
        "files": list(files),
        "samples": [int(record.measured.sum()) for record in found.dataset.records],
        "thinned": [record.decimation_factor for record in found.dataset.records],
        "seconds": seconds,
        "version": version("tendon-teleop"),
    }
    plain: dict[str, Any] = to_json_values(report)
    return plain


def _build_prediction_errors(
    records: Sequence[PredictedRecord], names: Sequence[str]
) -> list[dict[str, Any]]:
    """Return the errors of files that were not fitted."""
    return [
        {
            "file": name,
            "start": one.record.start,
            "end": one.record.start + float(one.record.time[-1]),
            "channels": {
                channel: {
                    "samples": int(one.record.good[channel].sum()),
                    "spikes": one.spikes[channel],
                    "baseline": _build_fitness(before),
                    "extended": _build_fitness(one.fitness(one.after)[channel]),
                }
                for channel, before in one.fitness(one.before).items()
            },
        }
        for name, one in zip(names, records, strict=False)
    ]


def _build_rivals(found: Diagnosis) -> list[dict[str, Any]]:
    """Return the models of equally good causes, and what they would do to the force."""
    forces = {(one.replaces, one.label): one for one in found.rival_forces}
    tree = []
    for one in found.rivals:
        force = forces.get((one.replaces, one.effect.label))
        model = one.fit.model
        tree.append(
            {
                "name": one.effect.name,
                "label": one.effect.label,
                "replaces": one.replaces,
                "base": {
                    p.name: value
                    for p, value in zip(found.dataset.base.shared, model.shared, strict=True)
                },
                "effects": {
                    effect.name: {
                        p.name: value for p, value in zip(effect.parameters, values, strict=True)
                    }
                    for effect, values in model.effects
                },
                "force_change": None if force is None else force._asdict(),
            }
        )
    return tree


def _build_candidates(ranking: Sequence[RankedCandidate]) -> list[dict[str, Any]]:
    """Return the candidates of a search, the best first."""
    return [
        {
            "name": ranked.name,
            "label": ranked.label,
            "score": ranked.score,
            "held_out_rmse": ranked.rmse,
            "left": ranked.residual_fraction,
            "parameters": {
                p.name: value
                for p, value in zip(ranked.effect.parameters, ranked.values, strict=True)
            },
        }
        for ranked in report_tables.select_best_candidates(ranking, len(ranking))
    ]


def _build_choice(choice: Choice, chosen: str) -> dict[str, Any]:
    """Return what was chosen, and the scores of all that could be."""
    return {
        "chosen": str(chosen),
        "alike": list(choice.equivalents) if len(choice.equivalents) > 1 else [],
        "scores": [
            {"name": one.name, "score": one.score, "held_out_rmse": one.rmse}
            for one in choice.scores
        ],
    }


def _build_fitness_sets(all_of: ModelErrors) -> dict[str, Any]:
    return {
        name: {channel: _build_fitness(one) for channel, one in getattr(all_of, name).items()}
        for name in report_tables.SAMPLE_SETS
    }


def _build_fitness(one: ErrorStatistics) -> dict[str, float]:
    return {
        "rmse": one.rmse,
        "max_percent": 100.0 * one.largest,
        "mean_percent": 100.0 * one.mean,
    }
