"""What to measure next, so that causes which look alike in the channels at hand come apart."""

from collections.abc import Iterable
from itertools import zip_longest

from estimator.effects.effect import DISTAL_DISPLACEMENT, DISTAL_TENSION, PROXIMAL_DISPLACEMENT

WEIGHTS = "hang the same known weight on both load cells"
TARE = "tare both load cells while the tendon is slack"
STRAIGHT_SHEATH = "one run with the sheath laid straight: friction goes, errors of sensors stay"
SEVERAL_SPEEDS = "the same swing at three speeds or more, down to creeping"
NESTED_SWINGS = "swings of several depths, nested in one another"
TENSION_HOLDS = "holds of 10 s or more at two tensions"
REPEATED_SWING = "the same swing at the beginning and at the end"
HARD_STOP = "a return to a hard stop now and then"
KNOWN_TRAVEL = "a known travel, measured beside the encoders"
PULLEY_TURNS = "two turns of the pulley or more"
BLOCKED_TIP = "a run with the tip blocked"
TEMPERATURE_LOG = "a log of the temperature"
TIP_CELL = "a load cell at the tip"
TIP_ENCODER = "an encoder at the tip"
MOTOR_TRAVEL = "the motor's travel"

ISOLATED_EFFECTS: dict[str, frozenset[str]] = {
    WEIGHTS: frozenset({"proximal_tension_gain", "distal_tension_gain"}),
    TARE: frozenset({"proximal_tension_bias", "distal_tension_bias"}),
    STRAIGHT_SHEATH: frozenset(
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
    SEVERAL_SPEEDS: frozenset(
        {"viscous_friction", "stribeck_friction", "sensor_lag", "tip_inertia", "stick_slip"}
    ),
    NESTED_SWINGS: frozenset(
        {
            "presliding",
            "distributed_play",
            "tension_dependent_friction",
            "joint_backlash",
            "sheath_rub",
        }
    ),
    TENSION_HOLDS: frozenset({"creep"}),
    REPEATED_SWING: frozenset(
        {
            "friction_step",
            "friction_drift",
            "proximal_tension_drift",
            "distal_tension_drift",
            "pretension",
            "tip_moved",
        }
    ),
    HARD_STOP: frozenset({"encoder_slip", "thermal_expansion", "creep"}),
    KNOWN_TRAVEL: frozenset({"encoder_scale"}),
    PULLEY_TURNS: frozenset({"pulley_eccentricity", "cogging_ripple"}),
    BLOCKED_TIP: frozenset(
        {"joint_friction", "joint_backlash", "antagonist_tension", "tip_inertia", "tip_moved"}
    ),
    TEMPERATURE_LOG: frozenset(
        {"thermal_expansion", "proximal_tension_drift", "distal_tension_drift", "friction_drift"}
    ),
}
"""Which effects an experiment singles out."""

SEPARATING_EXPERIMENTS = frozenset({WEIGHTS, TARE})
"""Experiments that tell the effects they single out from one another, too."""

_CHANNELS = {
    DISTAL_TENSION: TIP_CELL,
    PROXIMAL_DISPLACEMENT: MOTOR_TRAVEL,
    DISTAL_DISPLACEMENT: TIP_ENCODER,
}


def suggest_experiments(
    sets: Iterable[Iterable[str]], channels: Iterable[str], most: int = 3
) -> tuple[str, ...]:
    """Return experiments that tell effects apart which look alike, for each of some sets of them.

    First those that leave least together, then channels that were not measured.
    """
    useful = [_select_useful_experiments(frozenset(names)) for names in sets]
    in_turn = [what for turn in zip_longest(*useful) for what in turn if what is not None]
    found = list(dict.fromkeys(in_turn))[:most]
    missing = [text for channel, text in _CHANNELS.items() if channel not in set(channels)]
    return tuple([*found, *missing][: most + 1]) if found else ()


def _select_useful_experiments(wanted: frozenset[str]) -> list[str]:
    """Return the experiments that tell some of the effects apart, the best first."""
    left = {what: _count_unresolved(what, wanted) for what in ISOLATED_EFFECTS}
    useful = [what for what, count in left.items() if count < len(wanted)]
    return sorted(useful, key=lambda what: left[what])


def _count_unresolved(what: str, wanted: frozenset[str]) -> int:
    """Return how many of the effects an experiment leaves together, at worst."""
    seen = wanted & ISOLATED_EFFECTS[what]
    together = min(len(seen), 1) if what in SEPARATING_EXPERIMENTS else len(seen)
    return max(together, len(wanted - seen))
