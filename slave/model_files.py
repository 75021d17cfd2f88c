"""`--model`: model files of `teleop diagnose` that replace the configured sheaths.

--model model.yaml                    of every tendon
--model 1a=left.yaml --model 1b=r.yaml    of these, by joint and side or by number
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from estimator import noise_treatment
from estimator.array_types import Array
from estimator.law.sheath import ASSUMED_COMPLIANCE
from estimator.online.extended_model import EffectUse, explain_omission
from estimator.signals.spikes import SAMPLES_MIN
from slave.calibration.calibration_file import JointTendons
from slave.tendon_config import TendonConfig
from teleop.data import model_file
from teleop.errors import UsageError

# ratio to the calibrated friction above which a model is hardly of that sheath
FRICTION_RATIO_MAX = 1.4

ModelFiles = Mapping[str, Path]
"""Model files by tendon name; the empty name stands for all other tendons."""

_NAMED = re.compile(r"(?P<tendon>[1-9][0-9]*[ab]?)=(?P<file>.+)")


def parse(words: Sequence[str]) -> dict[str, Path]:
    """Return the files of the arguments of `--model`."""
    files: dict[str, Path] = {}
    for word in words:
        match = _NAMED.fullmatch(word)
        tendon, file = (match["tendon"], match["file"]) if match else ("", word)
        if not file:
            raise UsageError("--model: file name is missing")
        if tendon in files:
            of = f"tendon {tendon}" if tendon else "every tendon"
            raise UsageError(f"--model {word}: there is already a model for {of}")
        files[tendon] = Path(file)
    return files


def map_tendon_names(joints: JointTendons, count: int) -> dict[str, int]:
    """Return the tendons of a rig by name, counted from 0.

    By joint and side if known (1a, 1b, 2a, ...), and by number (1, 2, 3, ...).
    """
    sides = {
        f"{number}{'ab'[tendons.index(k)]}": k
        for number, tendons in enumerate(joints, start=1)
        for k in tendons
    }
    return sides | {str(k + 1): k for k in range(count)}


def apply_model_files(
    tendons: Sequence[TendonConfig | None], joints: JointTendons, files: ModelFiles
) -> tuple[TendonConfig | None, ...]:
    """Return the configs of the tendons, None if unknown, with model files applied.

    `UsageError` if there is no such tendon, or a file is invalid.
    """
    names = map_tendon_names(joints, len(tendons))
    out = [
        known if "" not in files else replace_sheath_model(known, files[""]) for known in tendons
    ]
    assigned: dict[int, str] = {}
    for name, file in files.items():
        if not name:
            continue
        if name not in names:
            raise UsageError(f"--model {name}={file}: must be one of {', '.join(names)}")
        k = names[name]
        if k in assigned:
            raise UsageError(
                f"--model {name}={file}: there is already a model for tendon {assigned[k]}"
            )
        assigned[k], out[k] = name, replace_sheath_model(tendons[k], file)
    return tuple(out)


def replace_sheath_model(tendon: TendonConfig | None, file: Path) -> TendonConfig:
    """Return a tendon with the sheath of a model file; noise and other settings are kept."""
    if tendon is None:
        tendon = TendonConfig(model_file=file)
        return set_sheath_length(tendon, tendon.length)
    return TendonConfig(
        model_file=file,
        length=sum(section.length for section in tendon.sections) or tendon.length,
        axial_stiffness=tendon.axial_stiffness,
        pretension=tendon.pretension,
        tension_noise=tendon.tension_noise,
        displacement_noise=tendon.displacement_noise,
        friction_error=tendon.friction_error,
        elongation_error=tendon.elongation_error,
        tip_tension_rate=tendon.tip_tension_rate,
        loop_friction=tendon.loop_friction,
    )


def set_sheath_length(tendon: TendonConfig, length: float) -> TendonConfig:
    """Return a tendon that is known from a model file alone, with a length [m] of its sheath.

    Where the model's data did not tell its elasticity, it has the L/EA that the diagnosis assumed:
    with another one the model's effects would give another force.
    """
    return replace(tendon, length=length, axial_stiffness=length / ASSUMED_COMPLIANCE)


def set_noise_from_data(tendon: TendonConfig, tension: Array, travel: Array | None) -> TendonConfig:
    """Return a tendon of a model file, its noise taken from data where none is configured.

    `tension` [N] and `travel` [m], if measured, are at the housing, shape (n,).
    """
    has_noise = tendon.tension_noise > 0.0 or tendon.displacement_noise > 0.0
    if tendon.model_file is None or has_noise or len(tension) < SAMPLES_MIN:
        return tendon
    return replace(
        tendon,
        tension_noise=noise_treatment.estimate_noise_sigma(tension),
        displacement_noise=0.0 if travel is None else noise_treatment.estimate_noise_sigma(travel),
    )


def find_friction_warnings(
    calibrated: Sequence[TendonConfig], used: Sequence[TendonConfig]
) -> list[str]:
    """Return a warning for each model file whose friction is far from the calibrated one.

    A model file does not name its rig.
    """
    warnings: dict[str, None] = {}
    for calibrated_tendon, used_tendon in zip(calibrated, used, strict=True):
        K_before, K = calibrated_tendon.build_model().sheath.K, used_tendon.build_model().sheath.K
        if (
            used_tendon.model_file != calibrated_tendon.model_file
            and not K_before / FRICTION_RATIO_MAX <= K <= K_before * FRICTION_RATIO_MAX
        ):
            line = f"{used_tendon.model_file}: its K is {K:.3g}, the calibrated K is {K_before:.3g}"
            warnings[f"WARNING: {line}; check that it is of this sheath, bent as now"] = None
    return list(warnings)


def describe_effects(tendon: TendonConfig) -> list[str]:
    """Return how the loop uses each effect in a tendon's model file."""
    extended = tendon.load_extended_model()
    if extended is None or tendon.model_file is None:
        return []
    warnings = []
    for effect, _, use in extended.uses:
        reason = f": it {explain_omission(effect)}" if use is EffectUse.OMITTED else ""
        warnings.append(f"{effect.label} is {use.value}{reason}")
    saved = model_file.load(tendon.model_file)
    if saved.unexplained:
        warnings.append("WARNING: the model explains only a small part of the error in its data")
    if len(saved.model.shared) == 1:
        warnings.append(
            f"no elasticity in the model: axial_stiffness stays {tendon.axial_stiffness:g} N"
        )
    if saved.unsure:
        warnings.append(
            f"WARNING: its data do not distinguish this from {', '.join(saved.unsure)}: if that "
            "is the cause, the force correction is wrong; record more data (see teleop diagnose)"
        )
    return warnings or ["sheath model without effects"]


def describe_models(tendons: Sequence[TendonConfig]) -> list[str]:
    """Return what the models of diagnoses do in the loop, with warnings, as lines."""
    notes: dict[str, None] = {}
    for tendon in tendons:
        for sentence in describe_effects(tendon):
            notes[f"{tendon.model_file}: {sentence}"] = None
        if tendon.model_file is not None and tendon.tension_noise == 0.0:
            line = f"WARNING: {tendon.model_file}: no tension_noise is known beside it: noise is"
            notes[f"{line} taken for tension, and a stuck load cell may not be noticed"] = None
    return list(notes)
