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
    interleaved = [
        experiment for turn in zip_longest(*useful) for experiment in turn if experiment is not None
    ]
    experiments = list(dict.fromkeys(interleaved))[:most]
    missing = [text for channel, text in _CHANNELS.items() if channel not in set(channels)]
    return tuple([*experiments, *missing][: most + 1]) if experiments else ()


def _select_useful_experiments(effects: frozenset[str]) -> list[str]:
    """Return the experiments that tell some of the effects apart, the best first."""
    unresolved = {
        experiment: _count_unresolved(experiment, effects) for experiment in ISOLATED_EFFECTS
    }
    useful = [experiment for experiment, count in unresolved.items() if count < len(effects)]
    return sorted(useful, key=lambda experiment: unresolved[experiment])


def _count_unresolved(experiment: str, effects: frozenset[str]) -> int:
    """Return how many of the effects an experiment leaves together, at worst."""
    isolated = effects & ISOLATED_EFFECTS[experiment]
    indistinct = min(len(isolated), 1) if experiment in SEPARATING_EXPERIMENTS else len(isolated)
    return max(indistinct, len(effects - isolated))
