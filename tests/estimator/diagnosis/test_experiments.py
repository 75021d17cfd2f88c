"""What to measure next tells apart what looks alike."""

import pytest

from estimator.diagnosis.outcome import (
    ISOLATED_EFFECTS,
    MOTOR_TRAVEL,
    SEPARATING_EXPERIMENTS,
    TARE,
    TIP_ENCODER,
    WEIGHTS,
    suggest_experiments,
)
from estimator.effects import CHANNELS, NAMES


@pytest.mark.parametrize(
    ("names", "what"),
    [
        (("proximal_tension_gain", "distal_tension_gain"), WEIGHTS),
        (("proximal_tension_bias", "distal_tension_bias"), TARE),
    ],
)
def test_weights_and_tare_tell_one_cell_from_the_other(names, what):
    assert suggest_experiments([names], CHANNELS)[0] == what


def test_each_set_gets_an_experiment_of_its_own():
    found = suggest_experiments(
        [("friction_step", "viscous_friction"), ("encoder_slip", "encoder_scale")], CHANNELS
    )
    for names in ({"friction_step", "viscous_friction"}, {"encoder_slip", "encoder_scale"}):
        assert any(len(names & ISOLATED_EFFECTS[what]) == 1 for what in found)


def test_nothing_alike_needs_no_experiment_and_channels_come_last():
    assert suggest_experiments([], CHANNELS) == ()
    assert suggest_experiments([("creep",)], CHANNELS) == ()
    few = suggest_experiments([("creep", "slack")], ("proximal_tension", "distal_tension"))
    assert few[-2:] == (MOTOR_TRAVEL, TIP_ENCODER)


def test_experiments_speak_of_effects_that_there_are():
    for what, seen in ISOLATED_EFFECTS.items():
        assert seen <= set(NAMES), what
    assert set(ISOLATED_EFFECTS) >= SEPARATING_EXPERIMENTS
