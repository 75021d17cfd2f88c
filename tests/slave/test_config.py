"""The slave's settings: what cannot be is refused, what is doubtful is said."""

from pathlib import Path

import pytest

from slave.config import SlaveConfig, TendonConfig, find_config_warnings
from slave.control import ControlConfig
from slave.gate import GateConfig
from slave.rigs.replayed import ReplayedRigConfig
from teleop.coupling import PassivityConfig


@pytest.mark.parametrize("limit", [20.0, 15.0])
def test_the_controller_must_give_way_before_the_gate_does(limit):
    gate = GateConfig(tension_max=limit)
    with pytest.raises(ValueError, match=rf"control\.tension_max: .* gate.*{limit:g} N"):
        SlaveConfig(control=ControlConfig(tension_max=20.0), gate=gate)
    SlaveConfig(control=ControlConfig(tension_max=limit - 1.0), gate=gate)


def test_a_model_without_noise_is_doubted_where_motors_move():
    silent, told = (TendonConfig(effective_friction=0.8, tension_noise=s) for s in (0.0, 0.01))
    (line,) = find_config_warnings(SlaveConfig(tendons=(told, silent)))
    assert "tension_noise" in line
    assert find_config_warnings(SlaveConfig(tendons=(told,))) == []
    played = ReplayedRigConfig(file=Path("data.csv"))
    assert find_config_warnings(SlaveConfig(rig=played, tendons=(silent,))) == []
    (line,) = find_config_warnings(SlaveConfig(rig=played, tendons=(silent,)), PassivityConfig())
    assert "direct" in line
