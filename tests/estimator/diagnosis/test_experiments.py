"""What to measure next tells apart what looks alike."""

import pytest

from estimator.diagnosis.experiments import (
    EACH_BY_ITSELF,
    MOTOR,
    SEEN_BY,
    TARE,
    TIP_ENCODER,
    WEIGHTS,
    settling,
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
    assert settling([names], CHANNELS)[0] == what


def test_each_set_gets_an_experiment_of_its_own():
    found = settling(
        [("friction_step", "viscous_friction"), ("encoder_slip", "encoder_scale")], CHANNELS
    )
    for names in ({"friction_step", "viscous_friction"}, {"encoder_slip", "encoder_scale"}):
        assert any(len(names & SEEN_BY[what]) == 1 for what in found)


def test_nothing_alike_needs_no_experiment_and_channels_come_last():
    assert settling([], CHANNELS) == ()
    assert settling([("creep",)], CHANNELS) == ()
    few = settling([("creep", "slack")], ("proximal_tension", "distal_tension"))
    assert few[-2:] == (MOTOR, TIP_ENCODER)


def test_experiments_speak_of_effects_that_there_are():
    for what, seen in SEEN_BY.items():
        assert seen <= set(NAMES), what
    assert set(SEEN_BY) >= EACH_BY_ITSELF
