"""report.json: a study of a pair for programs, everything in SI units and radians."""

from importlib.metadata import version
from typing import Any

from estimator.pair import report_text
from estimator.pair.pair_structure import offset_share, structure
from estimator.pair.pair_study import PairStudy


def tree(found: PairStudy, seconds: float) -> dict[str, Any]:
    """Return the report; `seconds` is what the study took."""
    return {
        "sentence": report_text.sentence(found),
        "bends": [float(record.bend) for record in found.records],
        "friction": [number._asdict() for number in found.each],
        "friction_straight": found.friction._asdict(),
        "growth": found.growth._asdict(),
        "model": {name: float(value) for name, value in found.fit.model._asdict().items()},
        "neutral": list(found.fit.neutrals),
        "best_simple": found.best_simple,
        "better_model": report_text.better_model(found),
        "left_out": {
            method: [error._asdict() for error in errors]
            for method, errors in found.left_out.items()
        },
        "validation": [
            {
                "bend": one.bend,
                "ours": one.ours._asdict(),
                "baselines": {name: e._asdict() for name, e in one.baselines.items()},
            }
            for one in found.validation
        ],
        "structure": [part._asdict() for part in structure(found.records, found.predicted)],
        "offset_share": offset_share(found.records, found.predicted),
        "wrong": report_text.wrong(found),
        "seconds": seconds,
        "version": version("tendon-teleop"),
    }
