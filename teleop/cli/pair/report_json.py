"""report.json: a study of a pair for programs, everything in SI units and radians."""

from importlib.metadata import version
from typing import Any

from estimator.pair import report_text
from estimator.pair.pair_study import PairStudy, analyse_residuals, compute_offset_share


def build_report(found: PairStudy, seconds: float) -> dict[str, Any]:
    """Return the report; `seconds` is what the study took."""
    return {
        "sentence": report_text.format_sentence(found),
        "bends": [float(record.bend) for record in found.records],
        "friction": [number._asdict() for number in found.record_frictions],
        "friction_straight": found.friction._asdict(),
        "growth": found.growth._asdict(),
        "model": {name: float(value) for name, value in found.fit.model._asdict().items()},
        "neutral": list(found.fit.neutrals),
        "best_simple": found.best_simple,
        "better_model": report_text.format_model_warning(found),
        "left_out": {
            method: [error._asdict() for error in errors]
            for method, errors in found.left_out.items()
        },
        "validation": [
            {
                "bend": one.bend,
                "ours": one.model_error._asdict(),
                "baselines": {name: e._asdict() for name, e in one.baselines.items()},
            }
            for one in found.validation
        ],
        "structure": [part._asdict() for part in analyse_residuals(found.records, found.predicted)],
        "offset_share": compute_offset_share(found.records, found.predicted),
        "wrong": report_text.describe_errors(found),
        "seconds": seconds,
        "version": version("tendon-teleop"),
    }
