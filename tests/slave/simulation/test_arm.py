"""Joints that share tendons: the plant of an arm against what it must agree with."""

import dataclasses

import numpy as np
import pytest

from estimator.kinematics.arm import prepare_arm
from estimator.kinematics.forward import compute_part_frames, write_weight_torque
from slave.rigs.simulated import JointConfig, SimulatedRig, SimulatedRigConfig, TendonPlantConfig
from slave.simulation.arm import ArmPlantConfig
from slave.simulation.environment import FreeConfig, WallConfig
from slave.simulation.joint import BodyConfig
from slave.simulation.link_inertia import build_links, compute_link_motion
from slave.simulation.sensor_models import EncoderConfig, LoadCellConfig
from slave.simulation.space_contacts import (
    BallConfig,
    PlaneConfig,
    build_space_contacts,
    locate_surfaces,
    press_surface,
)
from studies.brute_force.routed import Bend, Pin, RoutedChain
from teleop.config.arm import BendingSectionConfig, load_arm
from teleop.errors import UsageError
from tests.root import ROOT
from tests.slave.heavy_arm import write_heavy_urdf

R = 0.005  # [m]
PASSING = ((R, 0.0, 0.0), (0.8 * R, R, 0.0), (0.8 * R, 0.8 * R, R))
URDF = ROOT / "configs" / "notes-arm.urdf"
TENDON = TendonPlantConfig(
    load_cell=LoadCellConfig(noise=0.0, resolution=0.0), encoder=EncoderConfig(lines=0)
)
BODY = BodyConfig(spring=0.0, friction=0.1, stops=(-0.008, 0.008))


def build_rig(radii=PASSING, tendons=2, body=BODY, environment=None, **arm):
    joint = JointConfig((TENDON,) * tendons, body, environment or FreeConfig())
    config = SimulatedRigConfig(joints=(joint,) * len(radii))
    if radii is not None:
        config = dataclasses.replace(config, arms=(ArmPlantConfig(radii=radii, **arm),))
    return SimulatedRig(config)


def run(rig, seconds, targets):
    """Return the truth of all samples, shape (n, 4, tendons), driven by `targets(time)` [m]."""
    truth = []
    for i in range(round(seconds * 1e3)):
        rig.write(np.asarray(targets(i * 1e-3)))
        rig.read(i * 1e-3)
        truth.append(rig._truth.copy())
    return np.array(truth)


def wind(travel, offset=0.001):
    """Return motor targets of pairs that pull their sheaths' ends by `travel` [m]."""
    return np.stack([travel + offset, -travel + offset], axis=1).ravel()


def test_joints_that_share_no_tendon_move_as_joints_of_no_arm():
    own = SimulatedRig(
        SimulatedRigConfig(joints=(JointConfig((TENDON,) * 2, BODY, FreeConfig()),) * 3)
    )
    shared = build_rig(np.diag([R] * 3).tolist(), friction=0.0, span=1e-3)

    def targets(time):
        return wind(0.006 * np.sin([3.0 * time, 2.0 * time, 4.0 * time]))

    first, second = run(own, 1.5, targets), run(shared, 1.5, targets)
    assert np.abs(first[:, 3] - second[:, 3]).max() < 2e-6  # [m], stuck joints give way a little
    assert np.abs(first[:, 2] - second[:, 2]).max() < 0.2  # [N]


def test_tendons_that_pass_a_joint_travel_with_it_and_load_it():
    """What drives each joint, summed over all tendons, balances the walls that they press."""
    rig = build_rig(friction=0.0, environment=WallConfig(position=0.001, stiffness=5000.0))
    ratio = rig._arm.ratio[:, 0]
    wanted = np.array([0.002, -0.003, 0.005])
    truth = run(rig, 1.5, lambda time: wind(ratio @ wanted * min(time, 1.0)))
    q = np.array([state.travel for state in rig._states])
    state, arm = rig._arm_state, rig._arm
    stretch = arm.compliance[:, 0] * (state.tension[:, 0] - BODY.pretension)
    assert truth[-1, 3, ::2] == pytest.approx(ratio @ q + stretch.sum(axis=1), abs=1e-9)
    assert np.sign(q).tolist() == [1.0, -1.0, 1.0]
    pressed = np.maximum(q - 0.001, 0.0) * 5000.0
    assert pressed.max() > 1.0
    assert rig.joint_forces == pytest.approx(pressed, abs=0.11)  # the joints' own friction


@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_passed_joints_take_tension_only_by_friction(friction):
    """Sliding in, the tension falls from joint to joint, at most by the capstan's ratio."""
    rig = build_rig(friction=friction, wrap=1.0)
    run(rig, 1.0, lambda time: wind(0.004 * np.array([0.0, 0.0, min(time, 0.9)])))
    end, *a = rig._arm_state.tension[2, 0]
    assert end == pytest.approx(rig._truth[2, 4])
    steps = np.array(a) / np.array([end, a[0]])
    if friction == 0.0:
        assert steps == pytest.approx(np.ones(2))
        return
    assert (steps < 1.0).all()
    assert (steps > np.exp(-1.02 * friction * 1.8)).all()  # at most 1.8 rad of wrap


BACK_AND_FORTH = ([0.0, 0.5, 1.0, 1.5, 2.0], [0.0, 2e-3, 4e-4, 1.6e-3, 2e-4])  # [s], [m]


@pytest.mark.parametrize("turned", [0.0, 0.003])  # [m] the first joint, of two
@pytest.mark.parametrize("is_section", [False, True])
def test_tension_behind_a_guide_is_that_of_a_chain_of_beads(turned, is_section):
    """Joints at rest, too: a tendon that stretches slides at a guide whose joint rests."""
    mu, wrap, length = 0.2, 1.0, 0.05
    sections = tuple(BendingSectionConfig(name, length) for name in "ab" if is_section)
    radii = ((R, 0.0), (R, R))
    guides = [Pin(0, R, mu, wrap, 0.03), Pin(1, R, 0.0, wrap, 0.03)]
    if is_section:
        radii = tuple(map(tuple, (np.eye(4) * R + np.eye(4, k=-2) * R).tolist()))
        guides = [Bend(0, R, mu, wrap, 1e-6, length, -1.0), Bend(1, R, 0.0, 0.0, 1e-6, length)]
    joint = 2 if is_section else 1  # of the tendon
    body = dataclasses.replace(BODY, friction=100.0, pretension=2.0)
    rig = build_rig(radii, body=body, friction=mu, wrap=wrap, sections=sections)
    chain = RoutedChain([(0.1, 0.2)], 0.0, 9000.0, guides, [0.0, 0.0], 2.0, beads=2)
    pairs = []
    for time in np.arange(0.0, 2.0, 1e-3):
        wanted = np.zeros(len(radii))
        wanted[0] = turned * min(time, 1.0)
        targets = wind(rig._arm.ratio[:, 0] @ wanted, offset=3e-4)
        targets[0] += 0.02 * (turned != 0.0) * min(time / 0.2, 1.0)  # against the joint's friction
        targets[2 * joint] += np.interp(time, *BACK_AND_FORTH)
        rig.write(targets)
        rig.read(time)
        if round(time * 1e3) % 10 == 0:
            chain.move_to(rig._truth[2, 2 * joint], rig.joint_angles[[0, joint]])
            pairs.append((rig.anchor_tensions[2 * joint], chain.tensions[-1]))
    tension, brute_force = np.array(pairs).T
    assert np.ptp(brute_force) > 4.0
    assert abs(tension - brute_force).max() < 0.005 * brute_force.max()


def test_single_tendons_balance_their_springs_at_the_start():
    rig = build_rig(tendons=1, body=dataclasses.replace(BODY, spring=300.0, friction=0.0))
    truth = run(rig, 0.3, lambda _: np.zeros(3))
    assert np.abs(truth[:, 3]).max() < 1e-6


def test_joints_end_at_their_stops():
    rig = build_rig()
    ratio = rig._arm.ratio[:, 0]
    run(rig, 1.0, lambda time: wind(0.009 * min(time, 1.0) * ratio @ np.ones(3)))
    q = np.array([state.travel for state in rig._states])
    assert (q < 0.008 + 1e-4).all()
    assert q.max() > 0.0075


@pytest.mark.parametrize(
    "surface",
    [
        PlaneConfig(point=(0.0, 0.0, 0.055), normal=(0.3, -0.2, -1.0), damping=0.0),
        BallConfig(centre=(0.004, 0.006, 0.07), radius=0.02),
    ],
)
def test_a_surface_turns_the_joints_by_the_slope_of_its_energy(surface):
    """Against differences of its energy over the joints: stiffness times depth, integrated."""
    arm = ArmPlantConfig(radii=PASSING, urdf=URDF, tip="tip", contacts=(surface,))
    contacts, links = build_space_contacts([(arm, arm.contacts)]), build_links([arm], np.full(3, R))

    def locate(q):
        return locate_surfaces(contacts, compute_link_motion(links, q, np.zeros(3)))

    def energy(q):
        depth = max(float(locate(q)[0][0]), 0.0)
        exponent = 1.0 if isinstance(surface, PlaneConfig) else 1.5
        return surface.stiffness * depth ** (exponent + 1.0) / (exponent + 1.0)

    q = np.array([0.0004, -0.0005, 0.0003])
    depth, slope = locate(q)
    assert depth[0] > 1e-3
    force = press_surface(contacts.surfaces[0], depth[0], depth[0], 1e-3)[0] * slope[0]
    step = 1e-7
    by_energy = [
        (energy(q + step * axis) - energy(q - step * axis)) / (2.0 * step) for axis in np.eye(3)
    ]
    assert force == pytest.approx(by_energy, rel=1e-5)


def test_tendons_hold_the_weight_of_the_links(tmp_path):
    """Without friction they balance it; the second joint's link hangs out sideways."""
    pytest.importorskip("urdf_parser_py")
    body = dataclasses.replace(BODY, friction=0.0, damping=20.0, pretension=3.0)
    kinematics = {"urdf": write_heavy_urdf(tmp_path), "tip": "tip", "gravity": (0.0, -9.81, 2.0)}
    rig = build_rig(body=body, friction=0.0, **kinematics)
    run(rig, 1.0, lambda _: np.zeros(6))
    driving = rig.joint_forces
    weight = np.empty((2, 3))
    write_weight_torque(
        prepare_arm(load_arm(kinematics["urdf"], tip="tip"))[0], rig.joint_angles,
        np.array(kinematics["gravity"]), np.empty((4, 4)), np.empty((6, 3)), weight,
    )  # fmt: skip
    assert np.abs(weight[0]).max() > 5.0 * R  # [N m]
    assert driving * R == pytest.approx(-weight[0], abs=0.02 * R)
    with pytest.raises(ValueError, match="gravity: needs urdf"):
        ArmPlantConfig(radii=PASSING, gravity=(0.0, 0.0, -9.81))


def test_links_that_swing_free_keep_their_energy(tmp_path):
    """Within 0.1 % of its exchange over 5 s: no friction, no damping, slack tendons, but weight."""
    pytest.importorskip("urdf_parser_py")
    gravity, urdf = (0.0, -9.81, 2.0), write_heavy_urdf(tmp_path)
    body = BodyConfig(
        mass=0.0, damping=0.0, friction=0.0, spring=0.0, pretension=0.0, stops=(-0.15, 0.15)
    )
    rig = build_rig(body=body, friction=0.0, urdf=urdf, tip="tip", gravity=gravity)
    arm = load_arm(urdf, tip="tip")
    prepared, energy = prepare_arm(arm)[0], []
    for i in range(5000):
        rig.write(np.full(6, -0.049))
        rig.read(i * 1e-3)
        speed = np.array([state.speed for state in rig._states])
        travel = rig.joint_travel - 0.5e-3 * speed  # where this was the speed: half a step ago
        mass = compute_link_motion(rig._arm.links, travel, speed).mass
        frames = compute_part_frames(prepared, travel / R, 1)[0][1:-1]
        weight = sum(
            part.mass * np.array(gravity) @ (frame[:3, :3] @ part.centre + frame[:3, 3])
            for part, frame in zip(arm.parts, frames, strict=True)
        )
        energy.append((0.5 * speed @ mass @ speed, -weight))
    kinetic, potential = np.array(energy[500:]).T  # the tendons are slack by then
    assert np.ptp(kinetic) > 0.02  # [J]
    assert np.ptp(kinetic + potential) < 1e-3 * np.ptp(kinetic)


@pytest.mark.parametrize(("mass", "apart"), [(1e-6, 1e-6), (0.05, np.inf)])
def test_inertia_of_eight_joints_leaves_the_plant_stable(mass, apart):
    """Sixteen tendons move four curved sections, as without mass if that is little."""
    radii = np.tril(np.full((8, 8), 0.003), -1) + np.diag([0.004] * 8)

    def move(mass):
        sections = tuple(BendingSectionConfig(f"s{k}", 0.05, 1.6, mass=mass) for k in range(4))
        rig = build_rig(radii.tolist(), sections=sections)
        ratio, rate = rig._arm.ratio[:, 0], np.linspace(2.0, 7.0, 8)
        truth = run(rig, 1.5, lambda time: wind(ratio @ (0.004 * np.sin(rate * time))))
        return rig.joint_travel, truth[:, 2].max()

    (without, _), (travel, tension) = move(0.0), move(mass)
    assert np.abs(travel - without).max() < apart
    assert np.abs(travel - without).max() > 0.0
    assert 1.0 < tension < 40.0  # [N]


def test_forces_differ_by_newtons_although_all_housings_agree():
    """No estimator knows: a wall moves the tip while what is near the motors sticks."""

    def press(moved):
        rig = build_rig(friction=0.1, environment=WallConfig(position=0.001, stiffness=5000.0))
        ratio, housing = rig._arm.ratio[:, 0], []
        for time in np.arange(2500) * 1e-3:
            if moved and time == 1.7:
                rig.set_environment(2, None, "position", 0.001 + moved)
            pulled = 0.004 * min(time, 1.0) - 3e-4 * np.clip((time - 1.2) / 0.2, 0.0, 1.0)
            rig.write(wind(ratio @ (0.0, 0.0, pulled)))
            rig.read(time)
            housing.append(rig._truth[:2].copy())  # tension and motor of each tendon
        return np.array(housing), rig.joint_forces[2]

    (housing, force), (same, other) = press(0.0), press(1e-3)
    assert np.abs(housing - same).max() < 1e-9  # [N], [m]
    assert force - other > 3.0  # [N]
    assert other > 1.0


@pytest.mark.parametrize(
    ("radii", "text"),
    [
        (((R, 0.0),), "radii: must have a row for each joint"),
        (((R, 0.0), (R,)), "radii: must be a table"),
        (((R, 0.0), (0.0, R), (R, R)), "radii: rows 1, 2, 3: there must be one ratio of positive"),
        (((R, 0.0), (-R, 0.0), (0.0, R)), "radii: row 3: there must be one ratio"),
        (((0.0, R), (R, 0.0)), "joint 1: its own tendons must turn it"),
        (((R, R), (R, R)), "radii: these tendons do not determine all joints"),
        (((R, 2.0), (0.0, R)), "radii: must be -1 to 1 m"),
    ],
)
def test_impossible_radii_are_refused(radii, text):
    with pytest.raises(ValueError, match=text):
        ArmPlantConfig(radii=radii)


def test_friction_is_one_number_or_one_a_joint():
    assert ArmPlantConfig(radii=PASSING, friction=(0.1, 0.2, 0.3)).list_friction()[1] == 0.2
    with pytest.raises(ValueError, match="friction: must be one number, or 3: one a joint"):
        ArmPlantConfig(radii=PASSING, friction=(0.1, 0.2))


def test_kinematics_of_another_arm_are_refused():
    with pytest.raises(UsageError, match="3 coordinates, but radii have 5 columns"):
        ArmPlantConfig(radii=np.diag([R] * 5).tolist(), urdf=URDF, tip="tip").load_kinematics()
