"""Forces on joints that share tendons: known only while all that they follow from is."""

import dataclasses
import math

import numpy as np
import pytest

from estimator.kinematics.arm import prepare_arm
from estimator.kinematics.forward import write_weight_torque
from estimator.online import online
from estimator.online.tendon_estimate import INVALID_INPUT
from estimator.structs import view_struct
from slave import control
from slave.arm_estimate import build_arm_estimator, estimate_arm_forces
from slave.config import TendonConfig
from slave.control import JointEstimate
from slave.rig_layout import EstimatedTendon, build_rig_layout
from teleop.config.arm import ArmConfig
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS
from tests.slave.heavy_arm import write_heavy_urdf

ARM = ArmConfig(radii=((0.005, 0.0), (0.004, 0.005)), friction=0.1, wrap=0.3)


def estimate_samples(arm, *displacements):
    """Yield the joints' estimates after samples with these displacements of the first joint [m]."""
    pairs = tuple((2 * k, 2 * k + 1) for k in range(len(arm.radii)))
    count = 2 * len(pairs)
    layout = view_struct(build_rig_layout(pairs, [arm]))
    estimator = build_arm_estimator(pairs, [arm])
    prepared = online.prepare_all([TendonConfig(effective_friction=0.5).build_model()] * count)
    states = online.build_initial_states(prepared)
    tendons = EstimatedTendon.array(MAX_TENDONS)
    tendons["valid"], tendons["tension"] = True, 5.0
    fields = tendons["estimate"]
    fields["distal_tension"][:count] = [6.0, 2.0, 4.0, 3.0, 2.5, 3.5][:count]
    fields["low"], fields["high"] = fields["distal_tension"] - 0.5, 7.0
    fields["elongation"] = fields["distal_displacement"] = 0.0
    force = np.full((3, MAX_JOINTS), math.nan)
    joints, offsets = JointEstimate.array(MAX_JOINTS), np.zeros(MAX_JOINTS)
    for displacement in displacements:
        fields["distal_displacement"][:2] = displacement
        control.estimate_joints(layout, tendons, offsets, force, joints)
        estimate_arm_forces(estimator, layout, prepared, states, tendons, 1e-3, joints, force)
        control.estimate_joints(layout, tendons, offsets, force, joints)
        yield joints[: len(pairs)].copy()


def test_a_force_is_not_used_once_an_angle_is_lost():
    before, after = estimate_samples(ARM, 0.0, math.nan)
    assert np.isfinite(before["force"]).all()
    assert not (before["status"] & INVALID_INPUT).any()
    assert not (np.isfinite(after["force"]) | np.isfinite(after["low"])).any()
    assert (after["status"] & INVALID_INPUT).all()


def test_the_weight_of_links_is_taken_from_the_forces_with_its_error(tmp_path):
    pytest.importorskip("urdf_parser_py")
    arm = ArmConfig(radii=np.diag([0.005] * 3).tolist(), urdf=write_heavy_urdf(tmp_path), tip="tip")
    (bare,) = estimate_samples(arm, 0.0)
    heavy = dataclasses.replace(arm, gravity=(0.0, -9.81, 2.0), mass_error=0.2)
    (found,) = estimate_samples(heavy, 0.0)
    torque = np.empty((2, 3))
    prepared = prepare_arm(heavy.load_kinematics())[0]
    workspace = np.empty((4, 4)), np.empty((6, 3))
    write_weight_torque(prepared, np.zeros(3), np.array(heavy.gravity), *workspace, torque)
    weight = torque[0] / 0.005
    assert np.abs(weight).max() > 5.0
    np.testing.assert_allclose(found["force"] - bare["force"], weight)
    spread = 0.2 * torque[1] / 0.005
    np.testing.assert_allclose(found["low"] - bare["low"], weight - spread)
    np.testing.assert_allclose(found["high"] - bare["high"], weight + spread)
