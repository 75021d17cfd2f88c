import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

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
    chain = joint.a.chain._replace(knobs=joint.a.chain.knobs._replace(slack=0.2))
    tendon = joint.a._replace(chain=chain)
    return joint._replace(a=tendon, b=tendon)


def swing(joint, seconds, dt=1e-3, state=None, motors=lambda _: (0.0, 0.0)):
    """Advance; return the travel and speed after each step, and the truth, (steps, 4, 2)."""
    state = state or init_joint(joint)
    rows, seen = [], []
    for k in range(round(seconds / dt)):
        state = advance_joint(joint, state, np.array(motors((k + 1) * dt)), 1, dt)
        rows.append((state.travel, state.speed))
        seen.append(compute_truth(joint, state))
    return np.array(rows).T, np.array(seen), state


# --- the body by itself


def test_a_free_joint_swings_at_its_own_frequency_and_loses_only_what_the_step_takes():
    """Implicit Euler: amplitude falls by 1/sqrt(1 + (w dt)^2) a step, a rate of w^2 dt / 2."""
    body = BodyConfig(mass=0.1, damping=0.0, spring=40.0, pretension=0.0)
    joint, omega = loose(joint_of(body)), 20.0
    start = init_joint(joint)._replace(travel=0.005)
    for dt in (1e-3, 1e-4):
        (travel, _), _, _ = swing(joint, 2.0, dt, start)
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
        (travel, _), _, _ = swing(joint, 1.0, dt)
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
    (travel, speed), _, _ = swing(joint, 5.0)
    assert not travel.any()
    assert not speed.any()
    (travel, _), _, _ = swing(loose(joint_of(replace(body, friction=1.9), push)), 5.0)
    assert np.ptp(travel) > 1e-4


def test_a_moving_joint_comes_to_rest_where_friction_has_eaten_its_energy():
    body = BodyConfig(mass=0.05, friction=0.5, spring=0.0, damping=0.0, pretension=0.0)
    joint = loose(joint_of(body))
    start = init_joint(joint)._replace(speed=0.2)
    (travel, speed), _, _ = swing(joint, 0.1, 1e-5, start)
    assert travel[-1] == pytest.approx(0.05 * 0.2**2 / 2 / 0.5, rel=1e-3)
    assert speed[-1] == 0.0


def test_a_stop_is_rigid_and_gives_nothing_back():
    body = BodyConfig(mass=0.1, spring=0.0, damping=0.0, pretension=0.0, stops=(-0.01, 0.002))
    joint = loose(joint_of(body))
    start = init_joint(joint)._replace(speed=0.1)
    (travel, speed), _, _ = swing(joint, 0.1, 1e-3, start)
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

    def energy(state):
        q = state.travel
        tissue, wall = max(0.0, q - depth), max(0.0, -0.004 - q)
        elastic = 0.5 * body.spring * q * q + joint.body.pull_back * q
        return (
            0.5 * body.mass * state.speed**2 + elastic + 0.4 * 5e4 * tissue**2.5 + 1e4 * wall * wall
        )

    state = init_joint(joint)
    before = energy(state)
    for target in motors:
        for _ in range(30):
            at = state.pulley
            state = advance_joint(joint, state, np.array(target), 1, 1e-3)
            _, _, (a, b), _ = compute_truth(joint, state)
            after = energy(state)
            assert after - before <= (a - b) * (state.pulley - at) + 1e-9
            before = after


def test_a_light_joint_is_the_limit_of_ever_lighter_ones():
    world = TissueConfig(position=0.003)
    motors = lambda t: (0.006 * math.sin(6.0 * t) ** 2, 0.0)  # noqa: E731

    def travel(mass):
        body = BodyConfig(mass=mass, damping=0.0)
        return swing(joint_of(body, world), 1.0, motors=motors)[0][0]

    weightless = travel(0.0)
    far, near = (np.abs(travel(mass) - weightless).max() for mass in (1e-2, 1e-3))
    assert near < 0.2 * far < 2e-5


# --- with its tendons


def test_a_single_tendon_pulls_against_the_spring():
    body = BodyConfig(mass=0.02, spring=300.0, pretension=2.0)
    joint = joint_of(body)
    (travel, _), seen, _ = swing(joint, 2.0, motors=lambda t: (min(0.008, 0.006 * t), 0.0))
    assert travel[-1] > 0.005
    assert seen[-1, T_OUT, 0] == pytest.approx(2.0 + 300.0 * travel[-1], abs=1e-9)
    assert seen[-1, Q_OUT, 0] == travel[-1]


def test_a_pair_pulls_one_way_and_the_other_alike():
    body = BodyConfig(spring=100.0, pretension=1.0, friction=0.2)
    world = CombinedEnvironmentConfig(parts=(WallConfig(), WallConfig(position=-0.008, side="b")))
    joint = joint_of(body, world, tendons=2)
    wave = lambda t: 0.010 * math.sin(3.0 * t)  # noqa: E731
    one, seen, _ = swing(joint, 2.2, motors=lambda t: (wave(t), -0.9 * wave(t)))
    other, mirrored, _ = swing(joint, 2.2, motors=lambda t: (-0.9 * wave(t), wave(t)))
    assert one[0].max() > 0.005
    assert one == pytest.approx(-other, abs=1e-9)
    assert seen == pytest.approx(mirrored[:, :, ::-1], abs=1e-6)
    force = seen[:, T_OUT, 0] - seen[:, T_OUT, 1]
    assert np.all(force[one[0] > 0.0081] > 0.0)  # the wall pushes against +


def test_at_a_stop_only_the_tendon_gives_way():
    body = BodyConfig(stops=(-0.01, 0.003))
    (travel, _), seen, _ = swing(joint_of(body), 1.5, motors=lambda t: (0.004 * t, 0.0))
    stopped = travel == 0.003
    assert stopped.sum() > 100
    assert np.all(np.diff(seen[stopped, T_IN, 0]) > 0.0)
    assert np.ptp(seen[stopped, T_OUT, 0]) > 0.5  # more than its spring is worth


def held_after(path, moved, seconds=1.0):
    """Drive the motor along `path` for 2 s, hold it, and let a load motor move the tip by `moved`.

    Return tensions at the housing and at the tip from then on, first the ones before.
    """
    ground = LoadMotorConfig(
        mode="position",
        profile=((0.0, 0.0), (2.5, 0.0), (2.5 + seconds, moved)),
        stiffness=1e6,
    )
    # pretension and K = 1, a tip that the load motor holds: blocked, then moved
    tendon = replace(COARSE, sheath=SheathConfig(nodes=100))
    joint = joint_of(BodyConfig(spring=0.0, pretension=3.0), ground, tendon=tendon)
    steps = round(2.5 + seconds, 6)
    _, seen, _ = swing(joint, steps, motors=lambda t: (path(min(t, 2.0)), 0.0))
    return seen[2490:, T_IN, 0], seen[2490:, T_OUT, 0]


def test_what_the_housing_sees_of_a_tip_that_is_moved_while_the_motor_holds():
    """Sliding at either end must turn first: a factor e^(2K) of tension that nobody sees."""
    pull = lambda t: 1e-3 * t  # noqa: E731
    pull_and_release = lambda t: 2e-3 * t if t < 1.0 else 2e-3 - 1.6e-3 * (t - 1.0)  # noqa: E731
    hidden = math.exp(2.0)

    T_in, T_out = held_after(pull, -5e-3)  # pulled away from the housing: the tip's tension rises
    silent = T_out < 0.97 * hidden * T_out[0]
    assert np.ptp(T_in[silent]) < 2e-3 * T_in[0]
    assert T_out[silent].max() > 6.5 * T_out[0]
    assert T_in[-1] > 1.05 * T_in[0]
    assert T_out[-1] / T_in[-1] == pytest.approx(math.e, rel=0.01)

    T_in, T_out = held_after(pull, 0.5e-3)  # let go towards the housing: seen at once and in full
    assert T_out[-1] < 0.85 * T_out[0]
    assert T_in / T_out == pytest.approx(math.e, rel=0.01)

    T_in, T_out = held_after(pull_and_release, -0.5e-3)
    assert T_out[-1] > 1.2 * T_out[0]
    assert T_in[100:] / T_out[100:] == pytest.approx(1.0 / math.e, rel=0.01)


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
    state, rows = init_joint(joint), []
    for k in range(4000):
        wave = 0.003 * math.sin(2.0 * math.pi * k / 2000)
        state = advance_joint(joint, state, np.array((wave, -wave)), 1, 1e-3)
        _, _, (a, b), _ = compute_truth(joint, state)
        rows.append((state.pulley - state.travel, a - b, state.travel))
    gap, force, travel = np.array(rows).T
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
    alone = [init_joint(joint) for joint in joints]
    compiled = to_compiled_list(joints)
    for k in range(200):
        targets = np.array([[2e-5 * k, 0.0], [-1e-5 * k, 2e-5 * k]])
        seen = advance_joints(compiled, together, targets, 1, 1e-3)
        for i, joint in enumerate(joints):
            alone[i] = advance_joint(joint, alone[i], targets[i], 1, 1e-3)
            assert np.allclose(seen[:, i], compute_truth(joint, alone[i]), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    "wrong",
    [
        {"mass": -1.0},
        {"damping": math.inf},
        {"friction": math.nan},
        {"spring": 1e9},
        {"stops": (0.0, 0.01)},
        {"stops": (-0.01, 5.0)},
        {"backlash": -1e-4},
    ],
)
def test_a_body_that_cannot_be_is_refused(wrong):
    (name,) = wrong
    with pytest.raises(ValueError, match=f"^{name}: must be"):
        BodyConfig(**wrong)
