"""The couplings with the simulated rig and its estimator: friction, noise, two tendons."""

import numpy as np
import pytest

from slave import loop as slave_loop
from slave.config import SlaveConfig, load_tendon_configs
from slave.gate import GateConfig
from slave.rigs.simulated import SimulatedRig, SimulatedRigConfig
from slave.simulation.environment import WallConfig
from studies.testbed.control_bench import build_joint
from studies.transparency.hand import DT, Arm, build_reach
from studies.transparency.system import (
    SETTLED,
    Network,
    Settings,
    Teleoperator,
    build_settings,
    run_hand,
)
from teleop.coupling import Bilateral, DirectConfig, PassivityConfig


class OnRig:
    """A simulated rig, driven as the other bodies are."""

    def __init__(self, config):
        self._rig = SimulatedRig(config.rig)
        self.time, self.tip, self.wanted = 0.0, 0.0, None
        self.model = slave_loop.build_rig_model(
            self._rig.joints,
            [t.build_model() for t in load_tendon_configs(config, self._rig.tendons)],
        )
        self._last = self._rig.read(0.0)

    def advance(self, _push):
        self.time += DT
        if self.wanted is not None:
            self._rig.write(np.array(self.wanted))
        self._last = self._rig.read(self.time)

    def read(self):
        return self._last

    def load(self):
        return 0.0


@pytest.mark.parametrize(
    ("coupling", "round_trip"),
    [(PassivityConfig(), 0.200), pytest.param(DirectConfig(), 0.200, marks=pytest.mark.slow)],
)
def test_a_wall_behind_a_sheath(coupling, round_trip):
    plant = build_joint(0.8, environment=WallConfig(position=0.002, stiffness=5000.0))
    rig_config = SimulatedRigConfig(joints=(plant,))
    slave = SlaveConfig(
        rig=rig_config,
        calibration="as-built",
        gate=GateConfig(displacement_min=-0.05, displacement_max=0.05),
        command_timeout=0.15,
    )
    rig = OnRig(slave)
    system = Teleoperator(
        Bilateral(coupling=coupling),
        rig,
        Network(round_trip, min(0.05, round_trip), 0.1),
        Settings(build_settings(0.5, 1.0).master, slave),
        rig.model,
    )
    arm = Arm(build_reach(0.005, begin=0.8 + round_trip))
    record = run_hand(system, arm, 3.4 + round_trip, engage=SETTLED + round_trip)
    assert record.engaged[-1]
    gained = record.work.max() * 1.0 / 0.5
    assert record.force.min() < -0.3
    if coupling.type == "passivity":
        assert record.credit.min() >= -1e-9
        assert gained <= 2.0 * coupling.reserve
        assert np.ptp(record.hand[-500:]) < 0.3e-3
    else:
        assert gained > 0.01
