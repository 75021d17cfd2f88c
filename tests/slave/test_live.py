"""Settings of the simulated environment that change while a session runs, without a step."""

from dataclasses import replace

import numpy as np
import pytest

from slave import live_settings
from slave.rigs.simulated import JointConfig, SimulatedRig, SimulatedRigConfig, TendonPlantConfig
from slave.simulation.environment import (
    SLEW_S,
    CombinedEnvironmentConfig,
    FreeConfig,
    LoadMotorConfig,
    TissueConfig,
)
from slave.simulation.tendon import SheathConfig
from studies.testbed.control_bench import build_joint
from teleop.errors import UsageError
from teleop.session.state_machine import State
from tests.slave.test_loop_on_rig import on_rig, run, slave, to

TISSUE = TissueConfig(position=0.002, stiffness=9000.0)
KEY = "slave.rig.joints.0.environment."


def build_rig(environment, effects=()):
    """Return a rig whose sheath has no friction, which would hide the tip, or keep what it was."""
    tendon = TendonPlantConfig(sheath=SheathConfig(friction=0.0))
    return SimulatedRig(
        SimulatedRigConfig(
            joints=(JointConfig(tendons=(tendon,), environment=environment),), effects=effects
        )
    )


def hold(rig, seconds, start_s=0.0, motor=0.006):
    """Return the true tension at the tip [N] in each millisecond, with the motor held."""
    tensions = []
    for k in range(round(1000 * seconds)):
        rig.read(start_s + 1e-3 * k)
        rig.write(np.array([motor]))
        rig.advance()
        tensions.append(float(rig._truth[2, 0]))
    return np.array(tensions)


@pytest.mark.parametrize(
    ("environment", "path", "value"),
    [
        (TISSUE, "stiffness", 30_000.0),
        (CombinedEnvironmentConfig(parts=(FreeConfig(), TISSUE)), "parts.1.stiffness", 0.0),
        (LoadMotorConfig(mode="position", stiffness=100.0), "stiffness", 3000.0),
    ],
)
def test_a_changed_environment_is_reached_without_a_step_of_force(environment, path, value):
    """In the end the tip feels what a rig feels that has the value from the start."""
    rig = build_rig(environment)
    before = hold(rig, 1.0)
    assert live_settings.change_setting(rig, KEY + path, str(value)) == f"{KEY}{path} = {value:g}"
    change = hold(rig, 1.5, 1.0)
    *_, name = path.split(".")
    other = replace(TISSUE if "parts" in path else environment, **{name: value})
    wanted = hold(build_rig(other), 2.5)[-1]
    assert abs(wanted - before[-1]) > 0.3
    assert change[-1] == pytest.approx(wanted, abs=0.02)
    steps = np.abs(np.diff([before[-1], *change]))
    assert steps.max() < 12.0 * abs(wanted - before[-1]) * 1e-3 / SLEW_S


def test_a_change_during_a_change_goes_on_from_where_it_is():
    rig = build_rig(TISSUE)
    before = hold(rig, 1.0)
    live_settings.change_setting(rig, KEY + "stiffness", "30000")
    rising = hold(rig, 0.5 * SLEW_S, 1.0)
    live_settings.change_setting(rig, KEY + "stiffness", "9000")
    falling = hold(rig, 2.0, 1.0 + 0.5 * SLEW_S)
    assert rising[-1] > before[-1] + 0.3
    assert abs(falling[0] - rising[-1]) < 0.02
    assert falling[-1] == pytest.approx(before[-1], abs=0.05)


@pytest.mark.parametrize(
    ("environment", "key", "value", "line"),
    [
        (TISSUE, "stiffness", "nan", "stiffness: must be 0 to 1e"),
        (TISSUE, "stiffness", "soft", "expected a number, got 'soft'"),
        (TISSUE, "damping", "1", "an environment of type tissue has no such number"),
        (TISSUE, "exponent", "2", "cannot be changed while the slave runs .allowed: stiffness"),
        (TISSUE, "stifness", "2", "did you mean 'stiffness'"),
    ],
)  # fmt: skip
def test_what_cannot_be_changed_is_one_line(environment, key, value, line):
    rig = build_rig(environment)
    with pytest.raises(UsageError, match=line) as caught:
        live_settings.change_setting(rig, KEY + key, value)
    assert "\n" not in str(caught.value)
    assert not rig._ramps


def engage(stiffness, seconds=1.6):
    """Return the force of each answer to the master [N]: pull for 0.4 s, hold, change at 0.8 s."""
    config = slave(
        build_joint(0.05, spring=200.0, environment=TISSUE, tendons=1, noise=0.0, resolution=0.0)
    )
    rig, bench = on_rig(config)

    def change(time, _last, sample):
        if time == 0.8:
            live_settings.change_setting(rig, KEY + "stiffness", str(stiffness))
        return sample

    session = run(config, to(0.006, 0.02), seconds, change, (rig, bench))
    assert bench.state is State.ENGAGED
    return np.array([state.force[0] for state in session.states])


def test_an_engaged_master_is_sent_no_step_of_force():
    """What the hand feels is this force, scaled: its steps are those of a hand that moves."""
    for stiffness, change in ((36_000.0, 6.0), (1000.0, -2.0)):
        forces = engage(stiffness)
        steps = np.abs(np.diff(forces))
        assert steps[700:799].max() < 1e-6
        assert steps[799:].max() < 1.2 * steps[:700].max()
        assert (forces[-1] - forces[799]) / change > 0.9
