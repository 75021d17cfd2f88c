"""Arms in space in the view: where they are drawn, and the force at their tips."""

import itertools
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.kinematics.arm import Arm, Joint, Offset
from estimator.kinematics.tip_wrench import SMALLEST_LEVER_M
from teleop.config.loading import ConfigDocument
from teleop.errors import UsageError
from teleop.messages.messages import (
    MAX_JOINTS,
    MAX_MESSAGE_SECTIONS,
    Command,
    Hand,
    Sheath,
    SlaveState,
    pad_values,
)
from teleop.messages.topics import COMMAND, HAND, SHEATH, STATE
from teleop.session.config import RunConfig
from teleop.view.columns import decode
from teleop.view.config import ViewConfig
from teleop.view.scene import Scene
from teleop.view.scene_geometry import ARROW, Shape, build_stage
from teleop.view.sinks import Sink
from teleop.view.space_arm import HandAxes, build_space_arm, load_arms, solve_tip_forces
from tests.root import ROOT
from tests.teleop.view.made_session import T0, Session, read

NOTES = ROOT / "configs" / "notes-arm.yaml"
POSE = (0.3, -0.4, 0.7, 0.2)  # [rad] of the joints of NOTES, its gripper's last
RADIUS = 0.005  # [m] of each of them
CONFIG = ViewConfig()


def read_notes(tmp_path=None, text=None):
    file = NOTES if text is None else tmp_path / "session.yaml"
    if text is not None:
        file.write_text(text)
    document = ConfigDocument.read(file)
    return load_arms(document, document.load(RunConfig).arms)


@pytest.fixture(scope="module")
def notes():
    (arm,) = read_notes()
    return arm


def compute_notes_points(angles):
    """Shoulder, elbow, wrist and tip of NOTES, as its URDF says in words."""
    shoulder = Rotation.from_rotvec([angles[0], 0, 0])
    elbow = np.array([0, 0, 0.008])
    lower = Rotation.from_euler("y", angles[1] - 0.6)
    hand = Rotation.from_euler("y", angles[2] + 1.2)
    wrist = elbow + lower.apply([0, 0, 0.03])
    tip = wrist + (lower * hand).apply([0, 0, 0.03])
    return shoulder.apply([np.zeros(3), elbow, wrist, tip])


def to_positions(*poses):
    positions = np.zeros((len(poses), MAX_JOINTS))
    for row, pose in zip(positions, poses, strict=True):
        row[: len(pose)] = np.array(pose) * RADIUS
    return positions


def build_notes_stage(arm, radius=math.inf):
    shapes = {tendon: Shape(tendon // 2, (0.5,), (radius,)) for tendon in range(8)}
    return build_stage(shapes, CONFIG, [arm])


# --- where an arm is drawn


def test_an_arm_is_drawn_where_its_links_are(notes):
    (place,) = build_notes_stage(notes).arms
    lines = place.build_lines(to_positions(POSE, (0, 0, 0, 0)))
    for row, pose in enumerate((POSE, (0, 0, 0, 0))):
        expected = place.to_scene(compute_notes_points(pose))
        np.testing.assert_allclose(lines.joints[row], expected[:3], atol=1e-12)
        np.testing.assert_allclose(lines.tip[row], expected[3], atol=1e-12)


# --- the force at the tip


def random_jacobians(rng, count, rows=20):
    """Jacobians of arms of revolute joints of some centimetres."""
    axes = rng.normal(size=(rows, count, 3))
    axes /= np.linalg.norm(axes, axis=2, keepdims=True)
    levers = rng.normal(0.0, 0.1, (rows, count, 3))
    return np.swapaxes(np.concatenate([np.cross(axes, levers), axes], axis=2), 1, 2)


@pytest.mark.parametrize("count", [3, 6])
def test_the_force_behind_the_torques_is_found(count):
    rng = np.random.default_rng(count)
    jacobians = random_jacobians(rng, count)
    wrench = rng.normal(size=(len(jacobians), 6)) * ([1] * 3 + [0.0 if count == 3 else 0.05] * 3)
    torque = np.einsum("nij,ni->nj", jacobians, wrench)
    found = solve_tip_forces(jacobians, torque, torque, torque)
    told = (found.axis_shares > 0.999).all(axis=1)
    assert told.sum() > 10
    np.testing.assert_allclose(found.force[told], wrench[told, :3], atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 4, 5])
def test_of_a_force_only_what_the_torques_determine_is_given(count):
    """An orthogonal projection of the true force f onto some directions p: p.p = p.f."""
    rng = np.random.default_rng(count)
    jacobians = random_jacobians(rng, count)
    wrench = rng.normal(size=(len(jacobians), 6)) * ([1] * 3 + [0.0 if count < 4 else 0.05] * 3)
    torque = np.einsum("nij,ni->nj", jacobians, wrench)
    force = solve_tip_forces(jacobians, torque, torque, torque).force
    np.testing.assert_allclose(
        (force * force).sum(axis=1), (force * wrench[:, :3]).sum(axis=1), atol=1e-9
    )
    shares = solve_tip_forces(jacobians, torque, torque, torque).axis_shares.sum(axis=1)
    directions = count if count < 4 else count - 3  # the others mix with moments
    assert np.median(shares) == pytest.approx(directions)


@pytest.mark.parametrize("count", [2, 3, 5, 6])
def test_the_interval_is_that_of_all_corners_of_the_torques(count):
    rng = np.random.default_rng(count)
    jacobians = random_jacobians(rng, count, rows=8)
    middle, half = rng.normal(size=(2, 8, count)) * 0.05
    low, high = middle - abs(half), middle + abs(half)
    found = solve_tip_forces(jacobians, middle, low, high)
    corners = []
    for signs in itertools.product((False, True), repeat=count):
        corner = np.where(signs, high, low)
        corners.append(solve_tip_forces(jacobians, corner, corner, corner).force)
    np.testing.assert_allclose(found.low, np.min(corners, axis=0), atol=1e-9)
    np.testing.assert_allclose(found.high, np.max(corners, axis=0), atol=1e-9)
    unit = found.force / np.linalg.norm(found.force, axis=1, keepdims=True)
    along = np.einsum("cni,ni->cn", corners, unit)
    np.testing.assert_allclose(found.along_low, along.min(axis=0), atol=1e-9)
    np.testing.assert_allclose(found.along_high, along.max(axis=0), atol=1e-9)


def test_an_unbounded_joint_leaves_only_what_it_moves_unbounded():
    jacobian = np.zeros((1, 6, 3))
    jacobian[0, :3] = np.diag([0.05, 0.03, 0.02])
    torque = np.array([[0.1, 0.0, 0.0]])
    ends = np.array([[0.05, -math.inf, -0.01]]), np.array([[0.15, math.inf, 0.01]])
    found = solve_tip_forces(jacobian, torque, *ends)
    np.testing.assert_allclose(found.low, [[1.0, -math.inf, -0.5]])
    np.testing.assert_allclose(found.high, [[3.0, math.inf, 0.5]])
    assert (found.along_low[0], found.along_high[0]) == pytest.approx((1.0, 3.0))


def test_a_direction_with_hardly_a_lever_is_left_out_of_force_and_interval():
    jacobian = np.zeros((1, 6, 3))
    jacobian[0, :3] = np.diag([0.05, 0.03, 0.9 * SMALLEST_LEVER_M])
    torque = np.array([[0.05, 0.03, 0.1]])
    found = solve_tip_forces(jacobian, torque, torque - 0.01, torque + 0.01)
    np.testing.assert_allclose(found.force, [[1.0, 1.0, 0.0]], atol=1e-12)
    x, y, z = found.list_components()
    assert np.isfinite([x, y]).all()
    assert np.isnan(z).all()


def test_a_force_against_positive_travel_pushes_the_tip_back(notes):
    """One joint about z, the tip 0.1 m along x: positive travel is +y, the force is -y."""
    limits = {"lower": -1.0, "upper": 1.0}
    arm = Arm((Joint("j", axis=(0, 0, 1), **limits),), Offset((0.1, 0.0, 0.0)))
    rows = np.zeros(1, STATE.message.schema.dtype)
    rows["joints"] = 1
    rows["force"][:, 0], rows["force_low"][:, 0], rows["force_high"][:, 0] = 3.0, 2.0, 5.0
    found = build_space_arm(arm, 0, np.array([0.01])).estimate_tip_forces(rows)
    np.testing.assert_allclose(found.force, [[0.0, -0.3, 0.0]], atol=1e-12)
    np.testing.assert_allclose([found.low[0, 1], found.high[0, 1]], [-0.5, -0.2])
    assert (found.along_low[0], found.along_high[0]) == pytest.approx((0.2, 0.5))
    rows["joints"] = 0
    assert not np.isfinite(notes.estimate_tip_forces(rows).force).any()


# --- from the config, into the view


def test_the_hand_moves_as_its_axes_say(notes):
    assert notes.hand.names == ("x", "y", "z", "grip")
    turned = HandAxes(2, ("grip", "z", "x"), Rotation.from_euler("z", 90, degrees=True).as_matrix())
    values = np.array([[9.0, 9.0, 9.0, 3.0, 1.0]])
    np.testing.assert_allclose(turned.select_translation(values), [[0.0, 1.0, 3.0]], atol=1e-12)


def test_an_arm_that_cannot_be_read_is_left_out_with_a_remedy(tmp_path, capsys):
    text = NOTES.read_text()
    assert read_notes(tmp_path, text) == ()
    (line,) = capsys.readouterr().err.splitlines()
    assert "notes-arm.urdf" in line
    assert "--config" in line


@pytest.mark.parametrize("hands", ["[7]", "{axes: [x]}", "[{registration: [0, 0]}]", "[{axes: 3}]"])
def test_hands_that_cannot_be_read_are_one_line(tmp_path, hands):
    text = f"master: {{mapping: {{type: space, hands: {hands}}}}}\n"
    with pytest.raises(UsageError, match=r"master\.mapping\.hands: must be a list of hands"):
        read_notes(tmp_path, text)


def test_joints_of_an_arm_without_kinematics_still_count(tmp_path):
    (tmp_path / "notes-arm.urdf").write_text(NOTES.with_suffix(".urdf").read_text())
    text = (
        "arms:\n  - {radii: [[0.005, 0.0], [0.004, 0.005]]}\n"
        "  - {urdf: notes-arm.urdf, tip: tip, radii: "
        "[[0.005, 0, 0], [0, 0.005, 0], [0, 0, 0.005]]}\n"
    )
    (arm,) = read_notes(tmp_path, text)
    assert (list(arm.joints), arm.has_gripper, arm.hand) == ([2, 3, 4], False, None)


def build_session():
    session = Session(0.0)
    for tendon in range(8):
        section = pad_values((0.5,), MAX_MESSAGE_SECTIONS), pad_values((0.1,), MAX_MESSAGE_SECTIONS)
        told = Sheath(
            tendon=tendon, joint=tendon // 2, sections=1,
            section_length=section[0], section_radius=section[1],
        )  # fmt: skip
        session.add(SHEATH, told, T0)
    for k in range(100):
        stamp = T0 + k * 10_000_000
        position = pad_values(tuple(RADIUS * part * k / 100 for part in POSE), MAX_JOINTS)
        force = pad_values((0.5, -0.2, 0.1, 1.0), MAX_JOINTS)
        ends = {
            "force_low": pad_values((0.4, -0.3, 0.0, 0.8), MAX_JOINTS),
            "force_high": pad_values((0.6, 0.0, 0.3, 1.2), MAX_JOINTS),
        }
        state = SlaveState(state=2, joints=4, position=position, force=force, **ends)
        session.add(STATE, state, stamp)
        session.add(COMMAND, Command(position=position), stamp)
        session.add(HAND, Hand(state=2, joints=4, position=position, force=force), stamp)
    return session


def test_the_view_shows_what_was_computed_at_the_rate_of_its_pictures(notes, tmp_path):
    session, path = build_session(), tmp_path / "arm.rrd"
    with Sink("rrd", CONFIG, "test", path, live=False, arms=1) as sink:
        scene = Scene(CONFIG, sink.stream, sink.lay_out, arms=[notes])
        scene.send(decode(session.messages))
    saved = read(path)
    links = saved["/scene/arm_0/links"]["LineStrips3D:strips"]
    drawn = [stamp for stamp in links if stamp is not None]
    assert len(drawn) == pytest.approx(CONFIG.rate_hz.levers * 1.0, abs=2)
    (place,) = build_notes_stage(notes, radius=0.1).arms
    rows = decode(session.messages)[STATE]
    forces = notes.estimate_tip_forces(rows)
    newest = rows["stamp_ns"][-1]
    lines = place.build_lines(rows["position"][-1:])
    np.testing.assert_allclose(links[newest][0], lines.links[0], atol=1e-6)
    shown = saved["/scene/arm_0/force"]
    np.testing.assert_allclose(shown["Arrows3D:origins"][newest], lines.tip, atol=1e-6)
    per_newton = ARROW * place.size / CONFIG.hand_scale_N
    expected = per_newton * place.rotation @ forces.force[-1]
    np.testing.assert_allclose(shown["Arrows3D:vectors"][newest], [expected], atol=1e-6)
    (ghost,) = saved["/scene/arm_0/asked"]["Points3D:positions"][newest]
    np.testing.assert_allclose(ghost, lines.tip[0], atol=1e-6)
    assert len(saved["/scene/arm_0/interval"]["LineStrips3D:strips"][newest]) == 3
    for axis, k in (("x", 0), ("y", 1), ("z", 2)):
        curve = saved[f"/tip_force/arm_0/{axis}"]["Scalars:scalars"]
        np.testing.assert_allclose(curve[newest], [forces.force[-1, k]])
        high = saved[f"/tip_force/arm_0/{axis}_high"]["Scalars:scalars"]
        np.testing.assert_allclose(high[newest], [forces.high[-1, k]])
    assert not any("joint_" in entity for entity in saved if entity.startswith("/scene"))
