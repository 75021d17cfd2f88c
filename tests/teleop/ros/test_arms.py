"""Arms as ROS nodes see them, without a network."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from teleop.config.loading import ConfigDocument
from teleop.messages.messages import SlaveState, pad_values
from teleop.ros.arms import load_ros_arms
from teleop.ros.output_topics import (
    NamingContext,
    build_arm_frames,
    to_slave_force,
    to_slave_measured,
    to_tip_poses,
)
from teleop.session.config import RunConfig
from tests.root import ROOT

RADIUS = 0.005


def load_naming(config):
    document = ConfigDocument.read(ROOT / "configs" / config)
    return NamingContext("/lab", 8, load_ros_arms(document, document.load(RunConfig).arms))


def place_of(message):
    """The pose of a Pose or a Transform, shape (4, 4)."""
    vector = getattr(message, "position", None) or message.translation
    q = getattr(message, "orientation", None) or message.rotation
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat((q.x, q.y, q.z, q.w)).as_matrix()
    pose[:3, 3] = vector.x, vector.y, vector.z
    return pose


def state_of(angles, force=(0.0,) * 4):
    forces = dict.fromkeys(("force", "force_low", "force_high"), pad_values(force, 8))
    travel = pad_values(RADIUS * np.array(angles), 8)
    return SlaveState(joints=4, stamp_ns=10**18, position=travel, **forces)


@pytest.fixture(scope="module")
def naming():
    return load_naming("notes-arm.yaml")


def tip_of(naming, angles):
    (sample,) = to_tip_poses("measured_cp", state_of(angles), naming)
    assert sample.name == "slave/measured_cp"
    assert sample.message.header.frame_id == "lab/base"
    return place_of(sample.message.pose)


def test_joints_and_links_have_the_names_of_the_urdf(naming):
    (sample,) = to_slave_measured(state_of((0.1, -0.2, 0.3, 0.4), (1.0, 2.0, 3.0, 4.0)), naming)
    assert sample.message.name == ["shoulder", "elbow", "wrist", "gripper"]
    assert sample.message.position == pytest.approx([0.1, -0.2, 0.3, 0.4])
    assert sample.message.effort == pytest.approx(RADIUS * np.arange(1.0, 5.0))
    frames = build_arm_frames(state_of((0.0,) * 4), naming).transforms
    links = [(frame.header.frame_id, frame.child_frame_id) for frame in frames]
    names = ["lab/base", "lab/upper", "lab/lower", "lab/hand", "lab/tip"]
    assert links == list(pairwise(names))


def test_the_pose_of_the_tip_is_that_of_its_frame_and_of_the_file(naming):
    angles = (0.3, -0.5, 0.7)
    chain = np.eye(4)
    for frame in build_arm_frames(state_of((*angles, 0.0)), naming).transforms:
        chain = chain @ place_of(frame.transform)
    np.testing.assert_allclose(tip_of(naming, (*angles, 0.0)), chain, atol=1e-12)
    turn = Rotation.from_euler("x", 0.3)  # the numbers of notes-arm.urdf
    place = turn.apply([0.0, 0.0, 0.008])
    turn *= Rotation.from_euler("y", -0.6 - 0.5)
    place += turn.apply([0.0, 0.0, 0.03])
    turn *= Rotation.from_euler("y", 1.2 + 0.7)
    np.testing.assert_allclose(chain[:3, 3], place + turn.apply([0.0, 0.0, 0.03]), atol=1e-12)


def test_the_force_in_the_frame_of_the_tip_does_the_work_of_the_joints(naming):
    angles, force, step = np.array([0.3, -0.5, 0.7, 0.0]), np.array([1.0, -2.0, 0.5]), 1e-6
    samples = to_slave_force(state_of(angles, (*force, 3.0)), naming)
    sample, gripper = samples
    assert (sample.name, sample.message.header.frame_id) == ("slave/measured_cf", "lab/tip")
    assert (gripper.name, gripper.message.wrench.force.x) == ("slave/joint_4/measured_cf", 3.0)
    wrench = sample.message.wrench.force
    tip = tip_of(naming, angles)
    on_tip = tip[:3, :3] @ (wrench.x, wrench.y, wrench.z)
    for k in range(3):
        turned = angles + step * np.eye(4)[k]
        work = on_tip @ (tip_of(naming, turned) - tip)[:3, 3]
        assert work == pytest.approx(-RADIUS * force[k] * step, rel=1e-4, abs=1e-13)


def test_nothing_is_told_of_an_arm_whose_angles_are_unknown(naming):
    unknown = dataclasses.replace(state_of((0.0,) * 4), position=(np.nan,) * 8)
    assert not list(to_tip_poses("measured_cp", unknown, naming))
    assert build_arm_frames(unknown, naming) is None


def test_two_arms_have_names_of_their_own():
    naming = load_naming("two-notes-arms.yaml")
    state = dataclasses.replace(state_of((0.0,) * 8), joints=8)
    (sample,) = to_slave_measured(state, naming)
    assert len(set(sample.message.name)) == 8
    assert sample.message.name[4] == "arm_2/shoulder"
    assert [pose.name for pose in to_tip_poses("measured_cp", state, naming)] == [
        "slave/measured_cp", "slave/arm_2/measured_cp",
    ]  # fmt: skip
    children = [frame.child_frame_id for frame in build_arm_frames(state, naming).transforms]
    assert len(set(children)) == len(children)
