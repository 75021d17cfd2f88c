"""Pose and Jacobian against scipy's rotations, differences, and the integrated curve."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from estimator.kinematics import rotations
from estimator.kinematics.arm import Arm, ArmError, CurvedSection, Joint, prepare_arm
from estimator.kinematics.forward import (
    compute_jacobian,
    compute_part_frames,
    compute_tip_pose,
    write_weight_torque,
)
from tests.estimator.kinematics.random_arms import (
    random_chain,
    random_coordinates,
    random_mixed_arm,
)


def homogeneous(rotation, position):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position
    return matrix


def to_matrix(offset):
    return homogeneous(Rotation.from_euler("xyz", offset.rpy).as_matrix(), offset.position)


def integrate_curve(bend, length):
    """Return the end of a curve of constant curvature, from the equation of its frame."""
    curvature = np.array([-bend[1], bend[0], 0.0]) / length

    def change(_, state):
        rotation = state[3:].reshape(3, 3)
        turned = [np.cross(curvature, row) for row in rotation]  # rows of R [k] are -k x row
        return np.concatenate([rotation[:, 2], -np.ravel(turned)])

    start = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    end = solve_ivp(change, (0.0, length), start, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return homogeneous(end[3:].reshape(3, 3), end[:3])


def pose_by_scipy(arm, q):
    pose, q = np.eye(4), list(q)
    for part in arm.parts:
        pose = pose @ to_matrix(part.offset)
        own = [q.pop(0) for _ in part.coordinates]
        if isinstance(part, CurvedSection):
            pose = pose @ integrate_curve(own[:2], part.length + (own[2] if own[2:] else 0.0))
        elif part.kind != "fixed":
            axis = np.array(part.axis) / np.linalg.norm(part.axis)
            if part.kind == "prismatic":
                pose = pose @ homogeneous(np.eye(3), own[0] * axis)
            else:
                turn = Rotation.from_rotvec(own[0] * axis).as_matrix()
                pose = pose @ homogeneous(turn, np.zeros(3))
    return pose @ to_matrix(arm.tip)


def jacobian_by_differences(arm, q, step=3e-4):
    """Return the Jacobian by central differences of fourth order."""
    columns = []
    for unit in np.eye(len(q)):

        def twist(h, unit=unit):
            ahead, behind = (compute_tip_pose(arm, q + side * h * unit) for side in (1, -1))
            turn = Rotation.from_matrix(ahead[:3, :3] @ behind[:3, :3].T).as_rotvec()
            return np.concatenate([ahead[:3, 3] - behind[:3, 3], turn]) / (2.0 * h)

        columns.append((4.0 * twist(step / 2) - twist(step)) / 3.0)
    return np.array(columns).T


@pytest.mark.parametrize("seed", range(10))
def test_pose_and_jacobian_of_random_arms(seed):
    rng = np.random.default_rng(seed)
    arm = random_mixed_arm(rng) if seed % 2 else random_chain(rng, 1 + seed % 8)
    prepared = prepare_arm(arm)[0]
    q = random_coordinates(rng, arm)
    assert compute_tip_pose(prepared, q) == pytest.approx(pose_by_scipy(arm, q), abs=1e-9)
    found = compute_jacobian(prepared, q)
    assert found == pytest.approx(jacobian_by_differences(prepared, q), abs=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-4, 0.1, 0.999999, 1.0, 1.000001, 3.1, 6.3])
def test_a_curved_section_is_exact_at_any_bend(angle):
    arm = prepare_arm(Arm((CurvedSection("bend", 0.1, 7.0, elongation=(-0.05, 0.05)),)))[0]
    for direction in (0.0, 0.7, 2.0, -1.0):
        bend = angle * np.array([math.cos(direction), math.sin(direction)])
        q = np.array([*bend, 0.02])
        assert compute_tip_pose(arm, q) == pytest.approx(integrate_curve(bend, 0.12), abs=1e-11)
        found = compute_jacobian(arm, q)
        assert found == pytest.approx(jacobian_by_differences(arm, q), abs=1e-10)


def test_part_frames_lie_on_the_curve_and_end_at_the_tip():
    rng = np.random.default_rng(3)
    arm = random_mixed_arm(rng)
    q = random_coordinates(rng, arm)
    prepared = prepare_arm(arm)[0]
    frames, parts = compute_part_frames(prepared, q, 4)
    assert parts.tolist() == [-1, 0, 0, 0, 0, 1, 2, 2, 2, 2, 3, 4]
    assert frames[0] == pytest.approx(np.eye(4))
    assert frames[-1] == pytest.approx(compute_tip_pose(prepared, q))
    base = to_matrix(arm.parts[0].offset)
    middle = base @ integrate_curve(q[:2] / 2, (0.12 + q[2]) / 2)
    assert frames[2] == pytest.approx(middle, abs=1e-11)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 2.0, math.pi - 1e-9, math.pi])
def test_rotations_are_those_of_scipy(angle):
    rng = np.random.default_rng(5)
    for _ in range(20):
        axis = rng.normal(size=3)
        vector = angle * axis / np.linalg.norm(axis)
        q = rotations.to_quaternion(*vector)
        reference = Rotation.from_rotvec(vector)
        matrix = np.empty((3, 3))
        rotations.to_rotation_matrix(q, matrix)
        assert matrix == pytest.approx(reference.as_matrix(), abs=1e-14)
        found = np.array(rotations.from_rotation_matrix(reference.as_matrix()))
        assert found[3] >= 0.0
        assert (Rotation.from_quat(found).inv() * reference).magnitude() < 1e-14
        back = np.array(rotations.to_rotation_vector(q))
        assert Rotation.from_rotvec(back).as_matrix() == pytest.approx(matrix, abs=1e-14)
        assert np.linalg.norm(back) == pytest.approx(angle, abs=1e-12)


BAD = [
    (lambda: Joint("a", lower=1.0, upper=1.0), "joint a: limits 1 to 1"),
    (lambda: Joint("a", "screw"), "joint a: kind 'screw', allowed are"),
    (lambda: CurvedSection("c", 0.0, 1.0), "section c: length 0.0 m"),
    (lambda: Arm(()), "0 coordinates, allowed are 1 to 8"),
    (lambda: Arm((Joint("a", "continuous"),) * 2), "two parts are named 'a'"),
    (
        lambda: Arm(tuple(Joint(f"j{i}", "continuous") for i in range(9))),
        "9 coordinates, allowed are 1 to 8",
    ),
]


@pytest.mark.parametrize(("make", "said"), BAD)
def test_impossible_arms_are_refused(make, said):
    with pytest.raises(ArmError, match=said.replace("(", r"\(")):
        make()


def with_masses(rng, arm):
    """Return an arm whose joints move links of random masses."""
    parts = [
        dataclasses.replace(part, mass=rng.uniform(0.01, 0.5), centre=tuple(rng.normal(0, 0.05, 3)))
        if isinstance(part, Joint)
        else part
        for part in arm.parts
    ]
    return Arm(tuple(parts), arm.tip)


@pytest.mark.parametrize("seed", range(4))
def test_weight_does_the_work_that_it_loses_of_its_height(seed):
    rng = np.random.default_rng(seed)
    arm = with_masses(rng, random_mixed_arm(rng) if seed % 2 else random_chain(rng, 5))
    prepared, gravity = prepare_arm(arm)[0], np.array([0.3, -2.0, -9.5])
    q = random_coordinates(rng, arm)

    def work(q):
        frames, _ = compute_part_frames(prepared, q, 1)
        return sum(
            part.mass * gravity @ (frame[:3, :3] @ part.centre + frame[:3, 3])
            for part, frame in zip(arm.parts, frames[1:-1], strict=True)
            if isinstance(part, Joint)
        )

    torque = np.empty((2, len(q)))
    write_weight_torque(prepared, q, gravity, np.empty((4, 4)), np.empty((6, 8)), torque)
    step = 1e-6 * np.eye(len(q))
    slopes = [(work(q + change) - work(q - change)) / 2e-6 for change in step]
    np.testing.assert_allclose(torque[0], slopes, atol=1e-7)
    assert (torque[1] >= np.abs(torque[0]) - 1e-12).all()
