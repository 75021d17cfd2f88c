"""Chains read from URDF against Pinocchio, which reads them itself (`pip install pin`, 430 MB)."""

import math

import numpy as np
import pytest

from estimator.kinematics.arm import prepare_arm
from estimator.kinematics.forward import compute_jacobian, compute_tip_pose
from estimator.kinematics.urdf import read_arm
from tests.estimator.kinematics.random_arms import random_chain, random_coordinates, write_urdf

pin = pytest.importorskip("pinocchio")
pytest.importorskip("urdf_parser_py")


def test_pose_and_jacobian_of_100_random_chains():
    rng = np.random.default_rng(1)
    for _ in range(100):
        arm = random_chain(rng, int(rng.integers(1, 9)))
        text = write_urdf(arm)
        read = read_arm(text.encode(), base="base", tip="tip")
        q = random_coordinates(rng, arm)
        model = pin.buildModelFromXML(text)
        data, q_pin = model.createData(), pin.neutral(model)
        columns = []
        for value, coordinate in zip(q, read.coordinates, strict=True):
            joint = model.joints[model.getJointId(coordinate.name)]
            turn = [value] if joint.nq == 1 else [math.cos(value), math.sin(value)]
            q_pin[joint.idx_q : joint.idx_q + joint.nq] = turn
            columns.append(joint.idx_v)
        frame = model.getFrameId("tip")
        reference = pin.computeFrameJacobian(
            model, data, q_pin, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )[:, columns]
        pin.framesForwardKinematics(model, data, q_pin)
        prepared = prepare_arm(read)[0]
        pose = data.oMf[frame].homogeneous
        assert compute_tip_pose(prepared, q) == pytest.approx(pose, abs=1e-9)
        assert compute_jacobian(prepared, q) == pytest.approx(reference, abs=1e-9)
