"""`--model`: the model files of diagnoses, in place of the configured sheaths.

--model model.yaml                    of every tendon
--model 1a=left.yaml --model 1b=r.yaml    of these, by joint and side or by number
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from estimator.online.extension import Use, why_left_out
from slave.calibration.file import JointTendons
from slave.tendon_config import TendonConfig
from teleop.data import model_file
from teleop.errors import UsageError

FAR = 1.4  # times the friction that was calibrated, from where a model is hardly of that sheath

Given = Mapping[str, Path]
"""Model files by the name of their tendon; that of every other tendon by the empty name."""

_NAMED = re.compile(r"(?P<tendon>[1-9][0-9]*[ab]?)=(?P<file>.+)")


def parse(words: Sequence[str]) -> dict[str, Path]:
    """Return the files that the words of `--model` name."""
    files: dict[str, Path] = {}
    for word in words:
        named = _NAMED.fullmatch(word)
        tendon, file = (named["tendon"], named["file"]) if named else ("", word)
        if not file:
            raise UsageError("--model: the name of a file is missing")
        if tendon in files:
            of = f"tendon {tendon}" if tendon else "every tendon"
            raise UsageError(f"--model {word}: a second model of {of}")
        files[tendon] = Path(file)
    return files


def names_of(joints: JointTendons, count: int) -> dict[str, int]:
    """Return what the tendons of a rig are called, and which it is, from 0.

    By joint and side where that is known (1a, 1b, 2a, ...), and by number (1, 2, 3, ...).
    """
    sides = {
        f"{number}{'ab'[tendons.index(k)]}": k
        for number, tendons in enumerate(joints, start=1)
        for k in tendons
    }
    return sides | {str(k + 1): k for k in range(count)}


def apply(
    tendons: Sequence[TendonConfig | None], joints: JointTendons, files: Given
) -> tuple[TendonConfig | None, ...]:
    """Return what is known of each tendon, None if nothing, with model files for their sheaths.

    Raises
    ------
    UsageError
        If there is no such tendon, or a file cannot be right.
    """
    names = names_of(joints, len(tendons))
    out = [known if "" not in files else with_model(known, files[""]) for known in tendons]
    told: dict[int, str] = {}
    for name, file in files.items():
        if not name:
            continue
        if name not in names:
            raise UsageError(f"--model {name}={file}: must be one of {', '.join(names)}")
        k = names[name]
        if k in told:
            raise UsageError(f"--model {name}={file}: a second model of tendon {told[k]}")
        told[k], out[k] = name, with_model(tendons[k], file)
    return tuple(out)


def with_model(tendon: TendonConfig | None, file: Path) -> TendonConfig:
    """Return a tendon whose sheath is that of a model file; noise and all else stay."""
    if tendon is None:
        return TendonConfig(model_file=file)
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
    )


def friction_warnings(
    calibrated: Sequence[TendonConfig], used: Sequence[TendonConfig]
) -> list[str]:
    """Return a warning for each model file whose friction is far from what was calibrated.

    Nothing in a model file says of which rig it is; measured data do not know.
    """
    said: dict[str, None] = {}
    for before, after in zip(calibrated, used, strict=True):
        K_before, K = before.model().sheath.K, after.model().sheath.K
        if after.model_file != before.model_file and not K_before / FAR <= K <= K_before * FAR:
            line = f"{after.model_file}: its K is {K:.3g}, the calibrated one {K_before:.3g}"
            said[f"WARNING: {line}: is it of this sheath, and bent as now?"] = None
    return list(said)


def describe(tendon: TendonConfig) -> list[str]:
    """Return what becomes of each effect that a tendon's model file has."""
    extended = tendon.extended()
    if extended is None or tendon.model_file is None:
        return []
    said = []
    for effect, _, use in extended.uses:
        why = f": it {why_left_out(effect)}" if use is Use.NOTHING else ""
        said.append(f"{effect.label} is {use.value}{why}")
    saved = model_file.load(tendon.model_file)
    if saved.unexplained:
        said.append("WARNING: most of what was wrong with the data it was fitted to is not in it")
    if len(saved.model.shared) == 1:
        said.append(
            f"it says nothing of elasticity: axial_stiffness stays {tendon.axial_stiffness:g} N"
        )
    if saved.unsure:
        said.append(
            f"WARNING: the data it was fitted to did not tell this from {', '.join(saved.unsure)}: "
            "if that is the cause, the force is put right wrongly; find out which (teleop diagnose)"
        )
    return said or ["the law of a sheath, no effects"]
