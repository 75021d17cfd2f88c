"""The velocity map against numpy's singular values, its active set against all sets."""

import itertools

import numpy as np
import pytest

from estimator.kinematics.arm import prepare_arm
from estimator.kinematics.forward import compute_jacobian
from estimator.kinematics.inverse import (
    InverseConfig,
    InverseStep,
    build_inverse_settings,
    step_inverse,
)
from tests.estimator.kinematics.random_arms import (
    random_chain,
    random_coordinates,
    random_mixed_arm,
)

DT = 1e-3
LENGTH = 0.07
POSITION = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
ALL = (1.0, 2.0, 1.0, 1.0, 1.0, 0.5)
MOVING = ("revolute", "prismatic")


def run(arm, q, twist, error=None, **options):
    """Return the step of an arm, and its Jacobian."""
    config = InverseConfig(rotation_length=LENGTH, **options)
    prepared, step = prepare_arm(arm)[0], InverseStep.array()[0]
    jacobian = compute_jacobian(prepared, q)
    error = np.zeros(6) if error is None else error
    settings = build_inverse_settings(config)[0]
    step_inverse(prepared, settings, jacobian, q, twist, error, DT, step)
    return step, jacobian


def weigh(arm, jacobian, weights):
    """Return W^1/2, the units of the coordinates, and the weighted Jacobian."""
    rows = np.sqrt(np.array(weights) * np.repeat([1.0, LENGTH**2], 3))
    units = np.array([LENGTH if c.is_linear else 1.0 for c in arm.coordinates])
    return rows, units, rows[:, None] * jacobian * units


def invert(arm, jacobian, weights, least):
    """Return the damped inverse by numpy."""
    rows, units, weighted = weigh(arm, jacobian, weights)
    kept = rows > 0.0
    u, s, vt = np.linalg.svd(weighted[kept], full_matrices=False)
    gain = s / np.maximum(s, least) ** 2
    found = np.zeros((len(units), 6))
    found[:, kept] = units[:, None] * (vt.T * gain) @ u.T * rows[kept]
    return found, s.min()


@pytest.mark.parametrize("least", [1e-4, 0.02, 0.2])
@pytest.mark.parametrize("weights", [POSITION, ALL])
def test_the_map_is_the_damped_inverse(weights, least):
    rng = np.random.default_rng(0)
    for count in (2, 3, 4, 6, 8, 0):
        arm = random_chain(rng, count, MOVING, speed=np.inf) if count else random_mixed_arm(rng)
        q = 0.1 * random_coordinates(rng, arm)
        step, jacobian = run(
            arm, q, 1e-9 * rng.normal(size=6), weights=weights, singular_value=least
        )
        expected, smallest = invert(arm, jacobian, weights, least)
        found = step["velocity_map"][: len(q)] / step["scale"]
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-7 * abs(expected).max())
        assert step["singular_value"] == pytest.approx(smallest, abs=1e-8)
        _, units, _ = weigh(arm, jacobian, weights)
        rows = np.sqrt(np.array(weights) * np.repeat([1.0, LENGTH**2], 3))
        bounded = found / units[:, None] / np.where(rows > 0.0, rows, np.inf)
        assert np.linalg.norm(bounded, 2) <= (1.0 + 1e-9) / least


def best_cost(arm, jacobian, twist, weights, ends):
    """Return the least cost over all sets of held joints; `ends` is -1, 0, 1 for each joint."""
    rows, _, weighted = weigh(arm, jacobian, weights)
    limited = np.flatnonzero(ends)
    costs = []
    for chosen in itertools.product([False, True], repeat=len(limited)):
        free = np.ones(len(ends), bool)
        free[limited[np.array(chosen, bool)]] = False
        velocity = np.zeros(len(ends))
        if free.any():
            velocity[free] = np.linalg.lstsq(weighted[:, free], rows * twist, rcond=1e-12)[0]
        if (velocity * ends <= 1e-9 * abs(velocity).max()).all():
            costs.append(np.linalg.norm(weighted @ velocity - rows * twist))
    return min(costs)


@pytest.mark.parametrize("weights", [POSITION, ALL])
def test_joints_at_limits_are_held_as_the_optimum_has_it(weights):
    rng = np.random.default_rng(4)
    held = 0
    for _ in range(100):
        arm = random_chain(rng, int(rng.integers(3, 9)), ("revolute",), speed=np.inf)
        ends = rng.integers(-1, 2, len(arm.coordinates))
        q = np.where(ends == 0, rng.uniform(-0.5, 0.5, len(ends)), 2.0 * ends)
        twist = 1e-6 * rng.normal(size=6)  # far from the other limits
        step, jacobian = run(arm, q, twist, weights=weights, singular_value=1e-9)
        velocity = step["joint_velocity"][: len(q)]
        assert (velocity * ends <= 0.0).all()
        rows, units, weighted = weigh(arm, jacobian, weights)
        cost = np.linalg.norm(weighted @ (velocity / units) - rows * twist)
        best = best_cost(arm, jacobian, twist, weights, ends)
        assert cost == pytest.approx(best, rel=1e-6, abs=1e-12)
        held += np.count_nonzero(step["held"])
    assert held > 50


def test_limits_of_position_and_speed_hold_on_any_path():
    rng = np.random.default_rng(9)
    reached = 0
    for _ in range(4):
        arm = random_chain(rng, 6, ("revolute",), reach=0.1, speed=3.0)
        q = np.zeros(6)
        for tick in range(400):
            if tick % 100 == 0:
                twist, error = rng.normal(0.0, 5.0, 6), rng.normal(0.0, 0.1, 6)
            step, _ = run(arm, q, twist, error)
            velocity = step["joint_velocity"][:6]
            assert (abs(velocity) <= 3.0 * (1.0 + 1e-12)).all()
            q = q + DT * velocity
            assert (abs(q) <= 0.1 + 1e-12).all()
            reached += np.any(step["held"])
    assert reached > 200


def test_errors_are_corrected_while_the_hand_moves_and_only_then():
    rng = np.random.default_rng(11)
    arm = random_chain(rng, 6, ("continuous",), speed=np.inf)
    q = rng.uniform(-1.0, 1.0, 6)
    error = np.array([0.01, 0.0, 0.0, 0.0, 0.2, 0.0])
    at_rest, _ = run(arm, q, np.zeros(6), error)
    assert not np.any(at_rest["joint_velocity"])
    twist = np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    step, jacobian = run(arm, q, twist, error, singular_value=1e-6)
    correction = jacobian @ step["joint_velocity"][:6] - twist
    assert correction / np.linalg.norm(correction) == pytest.approx(
        error / np.linalg.norm(error), abs=1e-6
    )
    weighted = correction * np.repeat([1.0, LENGTH], 3)
    assert np.linalg.norm(weighted) == pytest.approx(0.1 * 0.1 * 0.1 / 0.105)
    small, _ = run(arm, q, twist, 1e-3 * error, singular_value=1e-6)
    slow = jacobian @ small["joint_velocity"][:6] - twist
    assert slow == pytest.approx(2.0 * 1e-3 * error, abs=1e-9)
