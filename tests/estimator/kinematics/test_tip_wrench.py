"""The wrench at the tip: what joint torques tell of it, and its interval."""

import numpy as np
import pytest

from estimator.kinematics.tip_wrench import compute_tip_wrench


def planar_jacobian(lengths, angles):
    """Return J of a planar arm in the xy plane from its geometry, shape (6, joints)."""
    headings = np.cumsum(angles)
    J = np.zeros((6, len(angles)))
    for j in range(len(angles)):
        x = np.sum(lengths[j:] * np.cos(headings[j:]))
        y = np.sum(lengths[j:] * np.sin(headings[j:]))
        J[:, j] = [-y, x, 0.0, 0.0, 0.0, 1.0]
    return J


def test_a_force_in_the_plane_of_the_arm_is_found_and_that_across_is_not_told():
    J = planar_jacobian(np.array([0.1, 0.08]), np.array([0.3, 0.9]))
    force = np.array([1.5, -2.0, 0.0, 0.0, 0.0, 0.0])
    tau = J.T @ force
    found = compute_tip_wrench(J, tau, tau - 0.01, tau + 0.01)
    np.testing.assert_allclose(found.wrench, force, atol=1e-12)
    assert found.is_identified.tolist() == [True, True, False]
    assert np.abs(found.directions[2] @ [0, 0, 1, 0, 0, 0]) == pytest.approx(1.0)
    assert np.isinf([found.low[2], found.high[2]]).all()
    rng = np.random.default_rng(0)
    for _ in range(50):  # whatever torque of the box is the true one
        true = np.linalg.solve(J[:2].T, tau + rng.uniform(-0.01, 0.01, 2))
        assert (found.low[:2] <= true).all()
        assert (true <= found.high[:2]).all()


def test_along_a_stretched_arm_no_force_is_told():
    J = planar_jacobian(np.array([0.1, 0.08]), np.array([0.0, 1e-4]))
    tau = np.array([0.1, 0.05])
    found = compute_tip_wrench(J, tau, tau, tau)
    assert found.is_identified.tolist() == [True, False, False]
    assert abs(found.wrench[0]) < 0.01  # not 0.05 N m over a lever of 10 um
    assert np.isinf(found.low[0])


def test_six_joints_tell_the_moment_whatever_the_length_scale():
    rng = np.random.default_rng(1)
    J = rng.normal(size=(6, 6)) * np.array([0.1, 0.1, 0.1, 1.0, 1.0, 1.0])[:, None]
    wrench = np.array([1.0, -2.0, 0.5, 0.02, -0.03, 0.01])
    tau = J.T @ wrench
    for scale in (0.02, 0.2):
        found = compute_tip_wrench(J, tau, tau, tau, length_scale=scale, smallest_lever=1e-6)
        np.testing.assert_allclose(found.wrench, wrench, atol=1e-9)
        assert found.is_identified.all()
