"""A diagnosis of an arm in words, with the joint or the tendon that a cause is in."""

from collections.abc import Sequence

import numpy as np

from estimator.diagnosis.arm import ArmDiagnosis, NamedCause
from estimator.diagnosis.arm_model import TRAVEL
from estimator.effects import CATALOGUE
from estimator.effects.effect import DISTAL_TENSION
from estimator.report_table import Table
from estimator.units import format_quantity

COUNTS = ("One thing is", "Two things are", "Three things are", "Four things are")
SAME_SHARE = 0.2  # of a radius: so near to another value it is that value
_SENSOR_CAUSES = {
    "proximal_tension_gain": "the load cell at the housing has a wrong gain, by {size}",
    "proximal_tension_bias": "the load cell at the housing reads {size} without tension",
    "distal_tension_gain": "the load cell in the arm has a wrong gain, by {size}",
    "distal_tension_bias": "the load cell in the arm reads {size} without tension",
    "encoder_scale": "the encoder of the motor reads travel {size} wrong",
    "encoder_play": "between the tendon and its encoder there is play of {size}",
}
_ADVICE = {
    "passed_joint_friction": "Look at the guides of this joint, or set `friction` of the arm.",
    "joint_radius": "Measure the pulley, and what turns this joint's encoder: if that reads by as "
    "much too little, the data look the same. Then set its column of `radii`.",
    "coupling": "Look at how these tendons pass this joint, and set the entry of `radii`.",
    "tendon_radius": "Look at how this tendon passes this joint: its partner passes it as known.",
    "encoder_scale": "Check counts per turn, gear and radius of the motor's pulley.",
    "encoder_play": "Tighten coupling and pulley between this motor and its encoder.",
}


def name_tendons(diagnosis: ArmDiagnosis, tendons: Sequence[int]) -> str:
    """Return the names of tendons as part of a sentence."""
    names = [diagnosis.tendons[i].name for i in tendons]
    if len(names) == 1:
        return f"tendon {names[0]}"
    return f"tendons {', '.join(names[:-1])} and {names[-1]}"


def describe_cause(diagnosis: ArmDiagnosis, entry: NamedCause) -> str:
    """Return a cause with its joint or tendon and its size, as part of a sentence."""
    cause, (value, low, high) = entry.cause, entry.value
    tendons = name_tendons(diagnosis, cause.tendons)
    joint = f"joint {cause.joint + 1}"
    if cause.kind == "passed_joint_friction":
        known = float(np.asarray(diagnosis.routing.friction)[cause.tendons[0], cause.joint])
        mu, ends = known + value, f"{known + low:.3g} to {known + high:.3g}"
        return (
            f"the friction of tendons that pass {joint} is {mu:.3g} ({ends}), not {known:.3g}; it "
            f"shows in {tendons}"
        )
    if cause.kind == "joint_radius":
        return (
            f"the radius of {joint} is {_format_share(value)} off ({_format_share(low)} to "
            f"{_format_share(high)}); it shows in {tendons}"
        )
    if cause.kind in ("coupling", "tendon_radius"):
        known = float(np.asarray(diagnosis.routing.radii)[cause.tendons[0], cause.joint])
        return (
            f"{_describe_entry(known, known + value, joint, tendons)} ({_format_mm(known + value)})"
        )
    size = format_quantity(abs(value), cause.unit, 2) if cause.unit else _format_share(value)
    return f"{tendons}: {_SENSOR_CAUSES[cause.kind].format(size=size)}"


def _describe_entry(known: float, radius: float, joint: str, tendons: str) -> str:
    """Return what is wrong with an entry of the routing, in words."""
    if known == 0.0:
        return f"{joint} moves {tendons}, which the config does not have"
    if abs(radius) < SAME_SHARE * abs(known):
        return f"{joint} does not move {tendons}, as the config has it"
    if abs(radius + known) < SAME_SHARE * abs(known):
        return f"{joint} moves {tendons} the other way: their entry of `radii` has the wrong sign"
    return f"{joint} moves {tendons} by another radius than {_format_mm(known)}"


def _format_share(value: float) -> str:
    return f"{100.0 * value:+.3g} %"


def _format_mm(value: float) -> str:
    return f"{1e3 * value:.3g} mm"


def give_advice(entry: NamedCause) -> str:
    """Return what to do about a cause."""
    for effect in CATALOGUE:
        if effect.name == entry.cause.kind and effect.name not in _ADVICE:
            return effect.advice
    return _ADVICE[entry.cause.kind]


def format_headline(diagnosis: ArmDiagnosis) -> str:
    """Return the verdict in a few words."""
    if diagnosis.is_clean:
        return "Nothing is wrong with the arm beyond noise."
    if not diagnosis.causes:
        return "Something is wrong with the arm, and no cause explains it."
    count = len(diagnosis.causes)
    parts = "; ".join(describe_cause(diagnosis, entry) for entry in diagnosis.causes)
    return f"{COUNTS[count - 1]} wrong: {parts}."


def build_tendon_table(diagnosis: ArmDiagnosis) -> Table:
    """Return the held-out errors of all tendons, without and with the causes."""
    rows = []
    for tendon in diagnosis.tendons:
        cells = [tendon.name]
        for channel, unit, factor in ((TRAVEL, "um", 1e6), (DISTAL_TENSION, "mN", 1e3)):
            if channel in tendon.noise:
                errors = (tendon.before[channel], tendon.after[channel], tendon.noise[channel])
                cells.append(" / ".join(f"{factor * error:.3g}" for error in errors) + f" {unit}")
            else:
                cells.append("")
        is_judged = bool(tendon.noise)
        cells.append(f"{tendon.K:.3g} ({tendon.known:.3g})" if is_judged else "-")
        rows.append((*cells, ("yes" if tendon.is_explained else "no") if is_judged else "-"))
    head = ("tendon", "travel: as known / with causes / noise", "tension: the same")
    return Table((*head, "K (as known)", "explained"), tuple(rows))


def list_notes(diagnosis: ArmDiagnosis) -> list[str]:
    """Return what the data cannot tell, and what is left to be found."""
    notes = []
    if not diagnosis.has_encoders:
        notes.append(
            "Joint angles were not measured but computed from the travels: wrong radii, signs and "
            "couplings cannot show. Record them as joint_angle_1_rad, joint_angle_2_rad, ..."
        )
    if not diagnosis.is_at_anchor:
        notes.append(
            "No tension was measured where tendons end in the arm: friction at passed joints "
            "cannot show. Record it as anchor_tension_N, anchor_tension_2_N, ..."
        )
    if idle := [tendon.name for tendon in diagnosis.tendons if not tendon.noise]:
        notes.append(
            f"Not judged, as too few samples are under tension and slide: tendon {', '.join(idle)}."
        )
    left = [tendon.name for tendon in diagnosis.tendons if not tendon.is_explained]
    if left:
        notes.append(
            f"Not explained by causes of an arm: tendon {', '.join(left)}; with --tendon "
            f"{left[0]} the effects of a single tendon are tried."
        )
    return notes


def format_arm_summary(diagnosis: ArmDiagnosis) -> str:
    """Return the result as text for a terminal."""
    lines = [format_headline(diagnosis), ""]
    for entry in diagnosis.causes:
        lines.append(
            f"{entry.cause.kind}: {describe_cause(diagnosis, entry)}. {give_advice(entry)}"
        )
        for rival in entry.rivals:
            names = name_tendons(diagnosis, rival.tendons)
            joint = f" of joint {rival.joint + 1}" * (rival.joint >= 0)
            lines.append(f"  these data do not tell it from {rival.kind}{joint}, {names}")
    notes = list_notes(diagnosis)
    return "\n".join([*lines, *notes, "", build_tendon_table(diagnosis).to_markdown()])
