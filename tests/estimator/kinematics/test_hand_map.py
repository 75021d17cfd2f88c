"""The hand map: no jumps, and an energy ledger that stays at zero."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.kinematics.arm import Arm, CurvedSection, Joint, Offset, prepare_arm
from estimator.kinematics.forward import compute_tip_pose, write_kinematics
from estimator.kinematics.hand_map import (
    HandMap,
    HandMapConfig,
    HandPose,
    build_hand_map_settings,
    step_hand_map,
    write_joint_map,
)
from estimator.kinematics.inverse import (
    InverseConfig,
    InverseStep,
    build_inverse_settings,
    step_inverse,
)

DT = 1e-3


class Teleoperation:
    """An arm in the hand, tick by tick."""

    def __init__(self, arm, q, hand_map=None, inverse=None):
        self.n = len(arm.coordinates)
        self.arm = prepare_arm(arm)[0]
        self.q = np.append(np.array(q, float), 0.0)  # the jaw is the last
        self.set_map(hand_map or HandMapConfig())
        self.inverse = build_inverse_settings(inverse or InverseConfig())[0]
        self.state, self.step = HandMap.array()[0], InverseStep.array()[0]
        self.pose, self.jacobian = np.empty((4, 4)), np.empty((6, self.n))
        self.force = np.zeros(7)

    def set_map(self, config):
        self.settings = build_hand_map_settings(config)[0]

    def tick(self, position, turn=(0.0, 0.0, 0.0), grip=0.0, engaged=True, torque=None):
        """Move the hand; return its work and that of the joints."""
        hand = HandPose.array()[0]
        hand["position"], hand["grip"] = position, grip
        hand["orientation"] = Rotation.from_rotvec(turn).as_quat()
        write_kinematics(self.arm, self.q, self.pose, self.jacobian)
        step_hand_map(self.settings, hand, engaged, self.pose, self.q[self.n], DT, self.state)
        twist, error = self.state["twist"], self.state["error"]
        step_inverse(self.arm, self.inverse, self.jacobian, self.q, twist, error, DT, self.step)
        write_joint_map(self.arm, self.step, self.state)
        torque = np.zeros(self.n + 1) if torque is None else torque
        self.force = self.state["joint_map"][: self.n + 1].T @ torque
        velocity = self.state["joint_velocity"][: self.n + 1]
        self.q = self.q + DT * velocity
        return DT * self.force @ self.state["velocity"], DT * torque @ velocity

    @property
    def tip(self):
        return compute_tip_pose(self.arm, self.q)


def endoscope_arm():
    """Return a curved section, a slide and a wrist of three joints."""
    fast = {"speed": 5.0, "lower": -1.2, "upper": 1.2}
    return Arm(
        (
            Joint("slide", "prismatic", lower=-0.03, upper=0.03, speed=0.2),
            CurvedSection("bend", 0.08, 1.5, bend_speed=5.0),
            Joint("roll", "revolute", **fast),
            Joint("pitch", "revolute", (0.0, 1.0, 0.0), Offset((0.0, 0.0, 0.01)), **fast),
            Joint("yaw", "revolute", (1.0, 0.0, 0.0), Offset((0.0, 0.0, 0.01)), **fast),
        ),
        Offset((0.0, 0.0, 0.015)),
    )


def planar_arm():
    """Return three joints that reach a plane, with room."""
    limits = {"lower": -2.5, "upper": 2.5}
    ahead = Offset((0.1, 0.0, 0.0))
    joints = [Joint(f"j{k}", offset=ahead if k else Offset(), **limits) for k in range(3)]
    return Arm(tuple(joints), ahead)


@pytest.mark.parametrize("align", [False, True])
def test_no_motion_of_the_hand_yields_energy(align):
    rng = np.random.default_rng(3)
    arm = Teleoperation(endoscope_arm(), [0.0] * 6, inverse=InverseConfig(singular_value=0.03))
    total = turnover = worst = 0.0
    slowed = held = damped = drawn = coupled = 0
    frequencies, phases = rng.uniform(2.0, 8.0, 7), rng.uniform(0.0, 6.0, 7)
    for k in range(4000):  # closed paths, through limits and straight postures
        waves = np.sin(frequencies * k * DT + phases)
        engaged = k % 500 > 60
        if k % 500 == 30:
            x = rng.normal(size=4)
            scale = rng.uniform(0.2, 2.0)
            arm.set_map(
                HandMapConfig(
                    translation_scale=scale,
                    rotation_scale=1.0 if align else scale,
                    registration=tuple(x / np.linalg.norm(x)),
                    lock=() if align else tuple(rng.choice(7, 2, replace=False)),
                    align_orientation=align,
                    grip_scale=scale,
                    jaw_limits=(-0.1, 0.1),
                )
            )
        torque = rng.normal(size=arm.n + 1)
        given, taken = arm.tick(0.03 * waves[:3], 0.5 * waves[3:6], 0.3 * waves[6], engaged, torque)
        total += given - taken
        turnover += abs(given)
        worst = max(worst, abs(total))
        moving = bool(np.any(arm.state["velocity"]))
        coupled += moving
        slowed += moving and arm.step["scale"] < 1.0
        held += moving and bool(np.any(arm.step["held"]))
        damped += moving and arm.step["singular_value"] < 0.03
        drawn += bool(np.any(arm.state["error"]))
    assert min(slowed, held, damped, drawn) > 50
    assert coupled > 3000
    assert worst < 1e-12 * turnover
    assert turnover > 0.01  # [J]


def test_the_orientation_aligns_while_the_hand_moves_without_a_jump():
    config = HandMapConfig(align_orientation=True, translation_scale=1.0)
    arm = Teleoperation(planar_arm(), [0.3, 0.4, 0.5], config)
    misaligned = [0.0, 0.0, 1.2 - 0.6]
    for k in range(8000):
        before = arm.tip
        circle = 0.02 * np.array([math.cos(0.01 * k), math.sin(0.01 * k), 0.0])
        arm.tick(circle, misaligned)
        turned = Rotation.from_matrix(arm.tip[:3, :3] @ before[:3, :3].T).magnitude()
        assert turned * 0.05 <= 0.1001 * np.linalg.norm(arm.state["twist"]) * DT + 1e-9
    angle = Rotation.from_matrix(arm.tip[:3, :3]).as_rotvec()[2]
    assert angle == pytest.approx(0.6, abs=0.01)


def test_the_grip_moves_the_jaw_within_its_limits():
    config = HandMapConfig(grip_scale=2.0, jaw_limits=(-0.1, 0.1))
    arm = Teleoperation(planar_arm(), [0.3, 0.4, 0.5], config)
    for k in range(200):
        arm.tick((0.0, 0.0, 0.0), grip=1e-4 * k, torque=np.array([0.0, 0.0, 0.0, 3.0]))
        if k == 10:
            assert arm.q[3] == pytest.approx(2e-3)
            assert arm.force[6] == pytest.approx(6.0)
    assert arm.q[3] <= 0.1
    arm.tick((0.0, 0.0, 0.0), grip=1.0, torque=np.array([0.0, 0.0, 0.0, 3.0]))
    assert arm.force[6] == 0.0


def test_a_pose_that_is_not_finite_disengages():
    arm = Teleoperation(planar_arm(), [0.3, 0.4, 0.5])
    arm.tick((0.0, 0.0, 0.0))
    arm.tick((math.nan, 0.0, 0.0), torque=np.ones(4))
    assert not np.any(arm.force)
    before = arm.q.copy()
    arm.tick((1.0, 0.0, 0.0))  # engages anew
    assert arm.q == pytest.approx(before)
    assert np.isfinite(arm.q).all()
