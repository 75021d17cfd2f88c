"""The slave's settings: what cannot be is refused, what is doubtful is said."""

import dataclasses
from pathlib import Path

import pytest

from slave.config import SlaveConfig, TendonConfig, find_config_warnings
from slave.control import ControlConfig
from slave.gate import GateConfig
from slave.rigs.replayed_data import ReplayedRigConfig
from slave.rigs.simulated import JointConfig, SimulatedRigConfig, TendonPlantConfig
from slave.simulation.sensing_loop import SensingLoopConfig
from slave.simulation.tendon import SheathConfig
from teleop.coupling import PassivityConfig


@pytest.mark.parametrize("limit", [20.0, 15.0])
def test_the_controller_must_give_way_before_the_gate_does(limit):
    gate = GateConfig(tension_max=limit)
    with pytest.raises(ValueError, match=rf"control\.tension_max: .* gate.*{limit:g} N"):
        SlaveConfig(control=ControlConfig(tension_max=20.0), gate=gate)
    SlaveConfig(control=ControlConfig(tension_max=limit - 1.0), gate=gate)


def test_a_sensing_loop_needs_cells_and_the_friction_it_had():
    plant = TendonPlantConfig(SheathConfig(nodes=20), loop=SensingLoopConfig())
    model = TendonConfig(effective_friction=0.8, tension_noise=0.01)
    looped = dataclasses.replace(model, loop_friction=0.5)

    def find(plant, *models):
        rig = SimulatedRigConfig(joints=(JointConfig((plant,)),))
        return find_config_warnings(SlaveConfig(rig, models))

    assert find(plant, looped) == []
    (line,) = find(plant, model)
    assert "not used without loop_friction" in line
    (line,) = find(dataclasses.replace(plant, loop=None), looped)
    assert "measures no loop" in line


def test_a_model_without_noise_is_doubted_where_motors_move():
    silent, told = (TendonConfig(effective_friction=0.8, tension_noise=s) for s in (0.0, 0.01))
    (line,) = find_config_warnings(SlaveConfig(tendons=(told, silent)))
    assert "tension_noise" in line
    assert find_config_warnings(SlaveConfig(tendons=(told,))) == []
    played = ReplayedRigConfig(file=Path("data.csv"))
    assert find_config_warnings(SlaveConfig(rig=played, tendons=(silent,))) == []
    (line,) = find_config_warnings(SlaveConfig(rig=played, tendons=(silent,)), PassivityConfig())
    assert "direct" in line
