import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from estimator.compiled import jit_compile
from slave.rigs.simulated import JointConfig, TendonPlantConfig, build_joint
from slave.simulation.environment import (
    CombinedEnvironmentConfig,
    FreeConfig,
    LoadMotorConfig,
    TissueConfig,
    WallConfig,
)
from slave.simulation.joint import (
    BodyConfig,
    advance_joint,
    advance_joints,
    compute_truth,
    init_joint,
    to_compiled_list,
)
from slave.simulation.tendon import SheathConfig

COARSE = TendonPlantConfig(sheath=SheathConfig(nodes=20))
T_IN, Q_IN, T_OUT, Q_OUT = range(4)


def joint_of(body, environment=None, tendons=1, tendon=COARSE):
    return build_joint(JointConfig((tendon,) * tendons, body, environment or FreeConfig()))


def loose(joint):
    """Return the joint with tendons so long that they never pull."""
    chain = joint.a.chain._replace(deviations=joint.a.chain.deviations._replace(slack=0.2))
    tendon = joint.a._replace(chain=chain)
    return joint._replace(a=tendon, b=tendon)


@jit_compile
def advance(joint, state, targets, dt):
    """Return the state at last and, after each step, travel, speed and pulley, and the truth."""
    rows, seen = np.empty((3, len(targets))), np.empty((len(targets), 4, 2))
    for k in range(len(targets)):
        state = advance_joint(joint, state, targets[k], 1, dt)
        rows[0, k], rows[1, k], rows[2, k] = state.travel, state.speed, state.pulley
        seen[k] = compute_truth(joint, state)
    return state, rows, seen


def swing(joint, seconds, dt=1e-3, state=None):
    """Advance with motors that rest; return the travel and the speed after each step."""
    state = init_joint(joint) if state is None else state
    return advance(joint, state, np.zeros((round(seconds / dt), 2)), dt)[1][:2]


# --- the body by itself


def test_a_free_joint_swings_at_its_own_frequency_and_loses_only_what_the_step_takes():
    """Implicit Euler: amplitude falls by 1/sqrt(1 + (w dt)^2) a step, a rate of w^2 dt / 2."""
    body = BodyConfig(mass=0.1, damping=0.0, spring=40.0, pretension=0.0)
    joint, omega = loose(joint_of(body)), 20.0
    start = init_joint(joint)._replace(travel=0.005)
    for dt in (1e-3, 2e-4):
        travel, _ = swing(joint, 1.0, dt, start)
        time = np.arange(1, len(travel) + 1) * dt
        crossings = time[1:][np.diff(np.sign(travel)) != 0]
        frequency = math.pi / np.diff(crossings).mean()
        assert frequency == pytest.approx(math.atan(omega * dt) / dt, rel=1e-3)
        peaks = np.flatnonzero(np.diff(np.sign(np.diff(travel))) < 0) + 1
        decay = -np.polyfit(time[peaks], np.log(travel[peaks]), 1)[0]
        assert decay == pytest.approx(0.5 * omega**2 * dt, rel=0.02)
    assert frequency == pytest.approx(omega, rel=2e-3)


def test_it_obeys_the_equation_of_motion_that_an_integrator_solves():
    """Mass, damping, spring, tissue and a load motor, against scipy; the error falls with dt."""
    body = BodyConfig(mass=0.05, damping=1.0, spring=100.0, pretension=0.0)
    points = tuple((t, 1.5 * math.sin(15.0 * t)) for t in np.linspace(0.0, 1.0, 501))
    tissue = TissueConfig(position=0.002, stiffness=2e4, exponent=1.5, dissipation=3.0)
    world = CombinedEnvironmentConfig(parts=(tissue, LoadMotorConfig(profile=points)))
    joint = loose(joint_of(body, world))
    times, forces = np.array(points).T

    def motion(t, y):
        q, v = y
        depth = max(0.0, q - 0.002)
        push = 2e4 * depth**1.5 * max(0.0, 1.0 + 3.0 * v) + np.interp(t, times, forces)
        return v, (-v - 100.0 * q - push) / 0.05

    exact = solve_ivp(motion, (0, 1), (0, 0), rtol=1e-8, atol=1e-11, max_step=2e-3, dense_output=1)
    errors = []
    for dt in (4e-4, 1e-4):
        travel, _ = swing(joint, 1.0, dt)
        error = travel - exact.sol(np.arange(1, len(travel) + 1) * dt)[0]
        errors.append(np.abs(error).max())
    assert np.ptp(exact.y[0]) > 0.01
    assert exact.y[0].max() > 0.003  # it has been in the tissue
    assert errors[1] < 1e-4
    assert errors[1] == pytest.approx(errors[0] / 4.0, rel=0.2)


def test_a_stuck_joint_does_not_creep():
    body = BodyConfig(mass=0.05, friction=2.0, spring=0.0, damping=0.0, pretension=0.0)
    push = LoadMotorConfig(profile=((0.0, 0.0), (0.1, 1.99), (0.2, -1.99)), repeat=True)
    joint = loose(joint_of(body, push))
    travel, speed = swing(joint, 5.0)
    assert not travel.any()
    assert not speed.any()
    travel, _ = swing(loose(joint_of(replace(body, friction=1.9), push)), 5.0)
    assert np.ptp(travel) > 1e-4


def test_a_stop_is_rigid_and_gives_nothing_back():
    body = BodyConfig(mass=0.1, spring=0.0, damping=0.0, pretension=0.0, stops=(-0.01, 0.002))
    joint = loose(joint_of(body))
    start = init_joint(joint)._replace(speed=0.1)
    travel, speed = swing(joint, 0.1, 1e-3, start)
    assert travel.max() == 0.002 == travel[-1]
    assert speed[-1] == 0.0
    assert np.all(np.diff(travel) >= 0.0)


@settings(max_examples=40, deadline=None)
@given(
    body=st.builds(
        BodyConfig,
        mass=st.floats(0, 1),
        damping=st.floats(0, 20),
        friction=st.floats(0, 5),
        spring=st.floats(0, 1000),
        pretension=st.floats(0, 5),
        stops=st.tuples(st.floats(-0.01, -1e-4), st.floats(1e-4, 0.01)),
        backlash=st.sampled_from((0.0, 5e-4)),
    ),
    depth=st.floats(-0.003, 0.003),
    motors=st.lists(st.tuples(*[st.floats(-0.01, 0.01)] * 2), min_size=1, max_size=5),
    tendons=st.sampled_from((1, 2)),
)
def test_body_and_environment_never_hold_more_energy_than_the_tendons_gave(
    body, depth, motors, tendons
):
    world = CombinedEnvironmentConfig(
        parts=(
            TissueConfig(position=depth, stiffness=5e4, exponent=1.5, dissipation=2.0),
            WallConfig(position=-0.004, stiffness=2e4, damping=5.0, side="b"),
        )
    )
    joint = joint_of(body, world, tendons)

    def energy(q, v):
        tissue, wall = np.maximum(0.0, q - depth), np.maximum(0.0, -0.004 - q)
        elastic = 0.5 * body.spring * q * q + joint.body.pull_back * q
        return 0.5 * body.mass * v**2 + elastic + 0.4 * 5e4 * tissue**2.5 + 1e4 * wall * wall

    start = init_joint(joint)
    _, (travel, speed, pulley), seen = advance(joint, start, np.repeat(motors, 30, axis=0), 1e-3)
    gain = np.diff(energy(travel, speed), prepend=energy(start.travel, start.speed))
    a, b = seen[:, T_OUT].T
    assert np.all(gain <= (a - b) * np.diff(pulley, prepend=start.pulley) + 1e-9)


# --- with its tendons


def test_backlash_is_crossed_where_the_load_changes_sides_and_nowhere_else():
    play = 4e-4
    body = BodyConfig(mass=0.0, damping=0.0, spring=0.0, pretension=1.0, backlash=play)
    walls = CombinedEnvironmentConfig(
        parts=(
            WallConfig(position=0.0, stiffness=2000.0),
            WallConfig(position=0.0, stiffness=2000.0, side="b"),
        )
    )
    joint = joint_of(body, walls, tendons=2)
    wave = 0.003 * np.sin(2.0 * math.pi * np.arange(4000) / 2000)
    targets = np.stack((wave, -wave), axis=1)
    _, (travel, _, pulley), seen = advance(joint, init_joint(joint), targets, 1e-3)
    gap, force = pulley - travel, seen[:, T_OUT, 0] - seen[:, T_OUT, 1]
    assert np.abs(gap).max() <= play / 2 * (1 + 1e-9)
    loaded = np.abs(force) > 1e-6
    assert gap[loaded] == pytest.approx(np.sign(force[loaded]) * play / 2, abs=1e-12)
    assert np.ptp(travel) > 1e-3
    crossing = np.abs(gap) < play / 2 * (1 - 1e-6)
    assert np.abs(travel[crossing]).max() < 1e-9
    assert 0.01 < crossing.mean() < 0.5


def test_joints_in_a_rig_are_the_joints_alone():
    configs = (
        JointConfig((COARSE,), BodyConfig(), TissueConfig(position=0.002)),
        JointConfig((COARSE, COARSE), BodyConfig(spring=50.0), FreeConfig()),
    )
    joints = [build_joint(config) for config in configs]
    together = to_compiled_list([init_joint(joint) for joint in joints])
    compiled = to_compiled_list(joints)
    targets = np.arange(200)[:, None, None] * np.array([[2e-5, 0.0], [-1e-5, 2e-5]])
    seen = np.array([advance_joints(compiled, together, t, 1, 1e-3) for t in targets])
    for i, joint in enumerate(joints):
        _, _, alone = advance(joint, init_joint(joint), targets[:, i].copy(), 1e-3)
        assert np.allclose(seen[:, :, i], alone, rtol=1e-12, atol=1e-15)
