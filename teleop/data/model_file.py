"""model.yaml: an extended model, to be read by people and read again by programs.

base:
  K: 0.83                       # friction coordinate of the tip
  compliance: 1.2e-04           # L/EA [m/N], where the record had a travel
  tip_compliance: 4.0e-04       # [m/N] of what the tip pulls at, 0 is a blocked tip
duration: 60.0                  # [s] of the longest record; drifts are evaluated at its end
unexplained: false              # whether most of the error is not in the model
unsure: [stribeck_friction]     # effects that the data do not distinguish from those of the model
live_error: [0.28, 0.16]        # [N] RMSE of the live force without and with it, on data not fitted
effects:                        # in this order
- name: friction_step
  where: ''                     # the variant, where there are several
  parameters: {change: 0.25, onset: 20.1}

A closed loop, a rotary record or load-independent friction is saved for people only, as
`transmission: {closed_loop, law, units, parameters}`.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from estimator.diagnosis.dataset import COMPLIANCE, FRICTION, TIP_COMPLIANCE, BaseLaw, Model
from estimator.diagnosis.outcome import Diagnosis, LiveError, Verdict
from estimator.diagnosis.record import parse_dimension
from estimator.effects import CATALOGUE, Effect, Parameter, Values
from estimator.effects.functions import find_function
from teleop.config import strict_yaml
from teleop.config.suggestions import suggest_spelling
from teleop.data.effect_extensions import is_extension, load_effects
from teleop.errors import UsageError
from teleop.runtime.process import write_text_file

BASE_PARAMETERS = {"K": FRICTION, "compliance": COMPLIANCE, "tip_compliance": TIP_COMPLIANCE}
"""Key -> what it is; a model of tensions alone has only the first."""

DURATION = Parameter("duration", "s", 0.0, 1e7, 1.0)

LIVE_ERROR = Parameter("live_error", "N", 0.0, 1e6, 1.0)

BOUND_TOLERANCE = 1e-6  # of a bound, tolerance of fitted values
# by which forces or travels may be larger or smaller than on the bench of the ranges
BENCH_SIZE_RATIO_MAX = 100.0


class SavedModel(NamedTuple):
    """Content of a model file."""

    model: Model  # without effects of single records
    duration: float  # [s] of the longest record
    unsure: tuple[str, ...]  # effects that the data do not distinguish from those of the model
    unexplained: bool = False  # whether most of the error is not in the model
    transmission: Mapping[str, Any] = MappingProxyType({})  # if it is no tendon of the capstan law
    live_error: LiveError | None = None


def from_diagnosis(diagnosis: Diagnosis) -> SavedModel:
    """Return the model for the loop that a diagnosis has found, to be saved."""
    base, model = diagnosis.dataset.base, diagnosis.live_model
    record = diagnosis.dataset.records[0]
    values = base.values(model.shared, np.mean(model.own, axis=0).tolist())
    names = [p.name for p in BASE_PARAMETERS.values() if p.name in values]
    if COMPLIANCE.name not in values:
        names = names[:1]
    transmission: dict[str, Any] = {}
    if record.loop or record.units.rotary or base.law is not BaseLaw.CAPSTAN:
        transmission = {
            "closed_loop": record.loop,
            "law": str(base.law),
            "units": [record.units.effort, record.units.travel],
            "parameters": {k: float(number.value) for k, number in diagnosis.parameters.items()},
        }
    return SavedModel(
        model._replace(
            shared=tuple(values[name] for name in names),
            own=(),
            effects=tuple(pair for pair in model.effects if not pair[0].file),
        ),
        max(float(record.time[-1]) for record in diagnosis.dataset.records),
        diagnosis.ambiguous_with,
        diagnosis.verdict is Verdict.UNEXPLAINED,
        transmission,
        None if diagnosis.has_idle_function else diagnosis.live_error,
    )


def save(path: Path, saved: SavedModel, remark: str) -> None:
    """Write a model atomically; `remark` becomes comments."""
    write_text_file(path, to_yaml(saved, remark), "the model")


def to_yaml(saved: SavedModel, remark: str) -> str:
    """Return a model as YAML."""
    model = saved.model
    lines = [f"# {line}" for line in remark.splitlines()]
    if saved.transmission:
        transmission = {"transmission": dict(saved.transmission)}
        return "\n".join(lines) + "\n" + strict_yaml.format_document(transmission)
    tree = {
        "base": {
            key: float(value) for key, value in zip(BASE_PARAMETERS, model.shared, strict=False)
        },
        "duration": float(saved.duration),
        "unexplained": saved.unexplained,
        "unsure": list(saved.unsure),
        **({"live_error": list(saved.live_error)} if saved.live_error else {}),
        "effects": [
            {
                "name": effect.name,
                "where": effect.where,
                "parameters": {
                    p.name: float(value) for p, value in zip(effect.parameters, values, strict=True)
                },
            }
            for effect, values in model.effects
        ],
    }
    units = [f"# base: {', '.join(f'{key} [{p.unit or 1}]' for key, p in BASE_PARAMETERS.items())}"]
    units += [
        f"# {effect.label}: {effect.equation}; "
        + ", ".join(f"{p.name} [{p.unit or 1}]" for p in effect.parameters)
        for effect, _ in model.effects
    ]
    return "\n".join([*lines, *units]) + "\n" + strict_yaml.format_document(tree)


def load(path: Path, effects: Sequence[Effect] = CATALOGUE) -> SavedModel:
    """Read a model: its numbers and its effects, without those of single records.

    An effect that is not among `effects` is imported, as `teleop.config.extensions` allows. Raises
    `UsageError` if the file is not a model file or is invalid.
    """
    tree = strict_yaml.read(path, "model")
    if isinstance(tree, dict) and "transmission" in tree:
        raise UsageError(
            f"{path}: a model of torques, of a closed loop or of load-independent friction; the "
            "estimator runs models of one tendon with the capstan law, in N and m"
        )
    if not isinstance(tree, dict) or "base" not in tree:
        raise UsageError(
            f"{path}: not a model file; give a model.yaml of `teleop diagnose --out DIR`"
        )
    keys_allowed = ("base", "duration", "unexplained", "unsure", "live_error", "effects")
    _reject_unknown_keys(path, "", tree, keys_allowed)
    base = _parse_mapping(path, "base", tree.get("base"))
    keys = list(BASE_PARAMETERS) if len(base) > 1 else ["K"]
    shared = _parse_numbers(
        path, "base", base, dict(zip(keys, BASE_PARAMETERS.values(), strict=False))
    )
    duration = _parse_number(path, "duration", tree.get("duration"), DURATION)
    unsure = tree.get("unsure") or []
    if not isinstance(unsure, list):
        raise UsageError(f"{path}: unsure: must be a list of names of effects")
    rows = tree.get("effects") or []
    if not isinstance(rows, list):
        raise UsageError(f"{path}: effects: must be a list of name, where and parameters")
    effect_values = tuple(
        _parse_effect(path, f"effects.{i}", row, effects) for i, row in enumerate(rows)
    )
    labels = [effect.label for effect, _ in effect_values]
    for label in labels:
        if labels.count(label) > 1:
            raise UsageError(f"{path}: effects: {label} occurs twice")
    functions = [effect.label for effect, _ in effect_values if effect.function is not None]
    if len(functions) > 1:
        raise UsageError(f"{path}: effects: {' and '.join(functions)}, one function at most is run")
    if not all(isinstance(name, str) for name in unsure):
        raise UsageError(f"{path}: unsure: must be a list of names of effects")
    unexplained = tree.get("unexplained", False)
    if not isinstance(unexplained, bool):
        raise UsageError(f"{path}: unexplained: {unexplained!r}, must be true or false")
    live_error = _parse_live_error(path, tree.get("live_error"))
    model = Model(shared, (), effect_values)
    return SavedModel(model, duration, tuple(unsure), unexplained, live_error=live_error)


def _parse_live_error(path: Path, value: Any) -> LiveError | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 2:
        raise UsageError(f"{path}: live_error: must be a list of two errors [N]")
    error = LiveError(*(_parse_number(path, "live_error", x, LIVE_ERROR) for x in value))
    if error.is_worse:
        raise UsageError(f"{path}: {error.describe()}; it is not for the loop")
    return error


def _parse_effect(
    path: Path, key: str, row: Any, effects: Sequence[Effect]
) -> tuple[Effect, Values]:
    row = _parse_mapping(path, key, row)
    _reject_unknown_keys(path, key, row, ("name", "where", "parameters"))
    name, where = str(row.get("name", "")), str(row.get("where") or "")
    variants = {effect.where: effect for effect in effects if effect.name == name}
    if not variants and (function := find_function(name)) is not None:
        variants = {"": function}
    if not variants and is_extension(name):
        found = load_effects(name, f"{path}: {key}.name")
        variants = {effect.where: effect for effect in found}
    if not variants:
        hint = suggest_spelling(name, {effect.name for effect in effects}, 3, 0.5)
        raise UsageError(f"{path}: {key}.name: there is no effect {name!r}{hint}")
    if where not in variants:
        allowed = ", ".join(repr(variant) for variant in variants)
        raise UsageError(f"{path}: {key}.where: {where!r} is no variant of {name}: {allowed}")
    effect = variants[where]
    parameters_key = f"{key}.parameters"
    numbers = _parse_mapping(path, parameters_key, row.get("parameters"))
    values = _parse_numbers(path, parameters_key, numbers, {p.name: p for p in effect.parameters})
    if effect.function and not effect.function.is_periodic and values[0] >= values[1]:
        raise UsageError(f"{path}: {parameters_key}: from {values[0]:g}, must be below to")
    return effect, values


def _parse_numbers(
    path: Path, place: str, tree: dict[str, Any], parameters: dict[str, Parameter]
) -> Values:
    _reject_unknown_keys(path, place, tree, parameters)
    return tuple(
        _parse_number(path, f"{place}.{key}", tree.get(key), p) for key, p in parameters.items()
    )


def _parse_number(path: Path, key: str, value: Any, parameter: Parameter) -> float:
    if value is None:
        raise UsageError(f"{path}: {key}: is missing")
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UsageError(f"{path}: {key}: {value!r} is not a finite number")
    low, high = _compute_range(parameter)
    if not low - BOUND_TOLERANCE * abs(low) <= value <= high + BOUND_TOLERANCE * abs(high):
        unit = f" {parameter.unit}".rstrip()
        raise UsageError(f"{path}: {key}: {value:g}{unit}, must be {low:g} to {high:g}{unit}")
    return float(value)


def _compute_range(parameter: Parameter) -> tuple[float, float]:
    """Return between which values a parameter may be, on a bench of any size."""
    wider = BENCH_SIZE_RATIO_MAX ** sum(map(abs, parse_dimension(parameter.unit)))
    low = parameter.low * (wider if parameter.low < 0.0 else 1.0 / wider)  # no sign is lost
    return low, parameter.high * (wider if parameter.high > 0.0 else 1.0 / wider)


def _parse_mapping(path: Path, key: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        fault = "is missing" if value is None else "is not a mapping (key: value lines)"
        raise UsageError(f"{path}: {key}: {fault}")
    return value


def _reject_unknown_keys(
    path: Path, place: str, tree: dict[str, Any], allowed: Iterable[str]
) -> None:
    for key in tree:
        if key not in allowed:
            at = f"{place}.{key}" if place else key
            raise UsageError(f"{path}: {at}: unknown key{suggest_spelling(key, allowed)}")
