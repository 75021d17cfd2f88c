"""Forces on joints that share tendons: known only while all that they follow from is."""

import math

import numpy as np

from estimator.online import online
from estimator.online.tendon_estimate import INVALID_INPUT
from estimator.records import view_struct
from slave import control
from slave.arm_estimate import build_arm_estimator, estimate_arm_forces
from slave.config import TendonConfig
from slave.control import JointEstimate
from slave.tendons import EstimatedTendon, build_rig_layout
from teleop.config.arm import ArmConfig
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS

JOINTS = ((0, 1), (2, 3))
ARM = ArmConfig(radii=((0.005, 0.0), (0.004, 0.005)), friction=0.1, wrap=0.3)


def test_a_force_is_not_used_once_an_angle_is_lost():
    layout = view_struct(build_rig_layout(JOINTS, [ARM]))
    estimator = build_arm_estimator(JOINTS, [ARM])
    prepared = online.prepare_all([TendonConfig(effective_friction=0.5).model()] * 4)
    states = online.build_initial_states(prepared)
    tendons = EstimatedTendon.array(MAX_TENDONS)
    tendons["valid"], tendons["tension"] = True, 5.0
    fields = tendons["estimate"]
    fields["distal_tension"][:4] = [6.0, 2.0, 4.0, 3.0]
    fields["low"][:4], fields["high"][:4] = fields["distal_tension"][:4] - 0.5, 7.0
    fields["elongation"] = fields["distal_displacement"] = 0.0
    force = np.full((3, MAX_JOINTS), math.nan)
    joints, offsets = JointEstimate.array(MAX_JOINTS), np.zeros(MAX_JOINTS)
    for displacement in (0.0, math.nan):  # the encoder of the first joint
        fields["distal_displacement"][:2] = displacement
        control.estimate_joints(layout, tendons, offsets, force, joints)
        estimate_arm_forces(estimator, layout, prepared, states, tendons, 1e-3, joints, force)
        control.estimate_joints(layout, tendons, offsets, force, joints)
        is_known = displacement == 0.0
        assert np.isfinite(joints["force"][:2]).all() == is_known
        assert ((joints["status"][:2] & INVALID_INPUT == 0) == is_known).all()
    assert np.isnan(joints["low"][:2]).all()
