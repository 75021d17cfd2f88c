"""report.json: a diagnosis for programs, in SI units."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

from estimator.diagnosis import report_text
from estimator.diagnosis.outcome import Diagnosis, Fitness, Fitnesses, Ranked
from teleop.tools.diagnose.acceptance import ComparedParameter
from teleop.tools.report.json_values import json_values


def tree(
    found: Diagnosis,
    files: Sequence[str],
    seconds: float,
    accepted: Mapping[str, ComparedParameter],
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
    """
    report = {
        "verdict": found.verdict.value,
        "sentence": report_text.sentence(found),
        "cause": list(found.causes),
        "candidates": _candidates(found.ranking),
        "ambiguous_with": list(found.ambiguous_with),
        "steps": [
            {
                "name": step.effect.name,
                "label": step.effect.label,
                "rivals": step.rivals,
                "candidates": _candidates(step.ranking),
            }
            for step in found.steps
        ],
        "parameters": {name: number._asdict() for name, number in found.parameters.items()},
        "baseline": _fitnesses(found.before),
        "extended": _fitnesses(found.after),
        "simple_models": {one.name: one.rmse for one in found.simple_models},
        "simple_gain": {channel: gain._asdict() for channel, gain in found.simple_gain.items()},
        "better_models": report_text.better_models(found),
        "gain": {channel: gain._asdict() for channel, gain in found.gain.items()},
        "noise": dict(found.noise),
        "driver": {
            "channel": found.dataset.records[0].driver,
            "noise": [record.noise[record.driver] for record in found.dataset.records],
        },
        "left": found.left,
        "wanders": found.wanders,
        "structure": [one._asdict() for one in found.structure],
        "detection_limits": {
            name: least._asdict() for name, least in found.detection_limits.items()
        },
        "sheath": {
            name: {"accepted": one.accepted, "agrees": one.agrees} for name, one in accepted.items()
        },
        "experiments": list(found.experiments),
        "next": report_text.next_steps(found),
        "troubles": [trouble._asdict() for trouble in found.troubles],
        "files": list(files),
        "samples": [int(record.measured.sum()) for record in found.dataset.records],
        "thinned": [record.thinned for record in found.dataset.records],
        "seconds": seconds,
        "version": version("tendon-teleop"),
    }
    plain: dict[str, Any] = json_values(report)
    return plain


def _candidates(ranking: Sequence[Ranked]) -> list[dict[str, Any]]:
    """Return the candidates of a search, the best first."""
    return [
        {
            "name": ranked.name,
            "label": ranked.label,
            "score": ranked.score,
            "held_out_rmse": ranked.rmse,
            "left": ranked.left,
            "parameters": ranked.values,
        }
        for ranked in report_text.best(ranking, len(ranking))
    ]


def _fitnesses(all_of: Fitnesses) -> dict[str, Any]:
    return {
        name: {channel: _fitness(one) for channel, one in getattr(all_of, name).items()}
        for name in report_text.SETS
    }


def _fitness(one: Fitness) -> dict[str, float]:
    return {
        "rmse": one.rmse,
        "max_percent": 100.0 * one.largest,
        "mean_percent": 100.0 * one.mean,
    }
