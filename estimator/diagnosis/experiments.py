"""What to measure next, so that causes which look alike in the channels at hand come apart."""

from collections.abc import Iterable
from itertools import zip_longest

from estimator.effects.effect import DISTAL_DISPLACEMENT, DISTAL_TENSION, PROXIMAL_DISPLACEMENT

WEIGHTS = "hang the same known weight on both load cells"
TARE = "tare both load cells while the tendon is slack"
STRAIGHT = "one run with the sheath laid straight: friction goes, errors of sensors stay"
SPEEDS = "the same swing at three speeds or more, down to creeping"
NESTED = "swings of several depths, nested in one another"
HOLDS = "holds of 10 s or more at two tensions"
REPEAT = "the same swing at the beginning and at the end"
STOP = "a return to a hard stop now and then"
TRAVEL = "a known travel, measured beside the encoders"
TURNS = "two turns of the pulley or more"
BLOCKED = "a run with the tip blocked"
TEMPERATURE = "a log of the temperature"
TIP_CELL = "a load cell at the tip"
TIP_ENCODER = "an encoder at the tip"
MOTOR = "the motor's travel"

SEEN_BY: dict[str, frozenset[str]] = {
    WEIGHTS: frozenset({"proximal_tension_gain", "distal_tension_gain"}),
    TARE: frozenset({"proximal_tension_bias", "distal_tension_bias"}),
    STRAIGHT: frozenset(
        {
            "friction_step",
            "friction_drift",
            "constant_drag",
            "stribeck_friction",
            "presliding",
            "distributed_play",
            "direction_asymmetry",
            "tension_dependent_friction",
            "nonuniform_curvature",
            "stick_slip",
        }
    ),
    SPEEDS: frozenset(
        {"viscous_friction", "stribeck_friction", "sensor_lag", "tip_inertia", "stick_slip"}
    ),
    NESTED: frozenset(
        {
            "presliding",
            "distributed_play",
            "tension_dependent_friction",
            "joint_backlash",
            "sheath_rub",
        }
    ),
    HOLDS: frozenset({"creep"}),
    REPEAT: frozenset(
        {
            "friction_step",
            "friction_drift",
            "proximal_tension_drift",
            "distal_tension_drift",
            "pretension",
            "tip_moved",
        }
    ),
    STOP: frozenset({"encoder_slip", "thermal_expansion", "creep"}),
    TRAVEL: frozenset({"encoder_scale"}),
    TURNS: frozenset({"pulley_eccentricity", "cogging_ripple"}),
    BLOCKED: frozenset(
        {"joint_friction", "joint_backlash", "antagonist_tension", "tip_inertia", "tip_moved"}
    ),
    TEMPERATURE: frozenset(
        {"thermal_expansion", "proximal_tension_drift", "distal_tension_drift", "friction_drift"}
    ),
}
"""Which effects an experiment singles out."""

EACH_BY_ITSELF = frozenset({WEIGHTS, TARE})
"""Experiments that tell the effects they single out from one another, too."""

_CHANNELS = {
    DISTAL_TENSION: TIP_CELL,
    PROXIMAL_DISPLACEMENT: MOTOR,
    DISTAL_DISPLACEMENT: TIP_ENCODER,
}


def settling(
    sets: Iterable[Iterable[str]], channels: Iterable[str], most: int = 3
) -> tuple[str, ...]:
    """Return experiments that tell effects apart which look alike, for each of some sets of them.

    First those that leave least together, then channels that were not measured.
    """
    useful = [_useful(frozenset(names)) for names in sets]
    in_turn = [what for turn in zip_longest(*useful) for what in turn if what is not None]
    found = list(dict.fromkeys(in_turn))[:most]
    missing = [text for channel, text in _CHANNELS.items() if channel not in set(channels)]
    return tuple([*found, *missing][: most + 1]) if found else ()


def _useful(wanted: frozenset[str]) -> list[str]:
    """Return the experiments that tell some of the effects apart, the best first."""
    left = {what: _left_together(what, wanted) for what in SEEN_BY}
    useful = [what for what, count in left.items() if count < len(wanted)]
    return sorted(useful, key=lambda what: left[what])


def _left_together(what: str, wanted: frozenset[str]) -> int:
    """Return how many of the effects an experiment leaves together, at worst."""
    seen = wanted & SEEN_BY[what]
    together = min(len(seen), 1) if what in EACH_BY_ITSELF else len(seen)
    return max(together, len(wanted - seen))
