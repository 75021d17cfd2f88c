"""Virtual fixtures: the force is the gradient of the energy, so closed paths give nothing."""

import math

import numpy as np
import pytest

from estimator.kinematics.arm import prepare_arm
from estimator.kinematics.forward import write_kinematics
from estimator.kinematics.inverse import InverseConfig, build_inverse_settings
from estimator.kinematics.virtual_fixtures import (
    FixturesConfig,
    Guide,
    Plane,
    build_fixtures,
    compute_tip_force,
    write_fixture_torque,
)
from tests.estimator.kinematics.random_arms import (
    random_chain,
    random_coordinates,
    random_mixed_arm,
)

FIXTURES = {
    "box": FixturesConfig(box=((-0.05, 0.05),) * 3),
    "planes": FixturesConfig(
        planes=(Plane((0.0, 0.0, 0.1), (0.0, 1.0, 2.0)), Plane((0.0, 0.1, 0.0), (3.0, 0.0, -1.0)))
    ),
    "guide": FixturesConfig(guide=Guide((0.0, 0.1, 0.0), (1.0, 1.0, 0.0), width=0.02)),
    "limits": FixturesConfig(limit_margin=1.5),
    "singularity": FixturesConfig(singular_value=0.06),
}
POSITION = InverseConfig(weights=(1.0, 1.0, 1.0, 0.0, 0.0, 0.0))
POSE = InverseConfig()


def make_torque(config, arm, weights):
    """Return a function from coordinates to torques and energy."""
    fixtures, prepared = build_fixtures(config)[0], prepare_arm(arm)[0]
    settings = build_inverse_settings(weights)[0]
    n = len(arm.coordinates)

    def evaluate(q):
        pose, jacobian, torque = np.empty((4, 4)), np.empty((6, n)), np.empty(n)
        write_kinematics(prepared, q, pose, jacobian)
        energy = write_fixture_torque(fixtures, prepared, settings, q, pose, jacobian, torque)
        return torque, energy

    return evaluate


def make_arms(rng):
    yield random_mixed_arm(rng), POSE
    for count in (2, 4, 6, 8):
        yield random_chain(rng, count, ("revolute", "prismatic")), POSITION


@pytest.mark.parametrize("name", FIXTURES)
def test_the_torque_is_the_gradient_of_the_energy(name):
    rng = np.random.default_rng(1)
    active = 0
    for arm, weights in make_arms(rng):
        evaluate = make_torque(FIXTURES[name], arm, weights)
        for _ in range(10):
            q = random_coordinates(rng, arm)
            torque, energy = evaluate(q)
            slope = [
                (evaluate(q + h)[1] - evaluate(q - h)[1]) / 2e-6 for h in 1e-6 * np.eye(len(q))
            ]
            assert -torque == pytest.approx(np.array(slope), rel=1e-4, abs=1e-6)
            active += energy > 1e-6
    assert active > 10


def test_walls_push_back_with_their_stiffness_up_to_the_largest_force():
    fixtures = build_fixtures(
        FixturesConfig(
            box=((-math.inf, 0.1), (-0.2, math.inf), (-math.inf, math.inf)),
            stiffness=300.0,
            force_max=3.0,
        )
    )[0]
    assert compute_tip_force(fixtures, 0.0, 0.0, 9.0) == (0.0, 0.0, 0.0, 0.0)
    assert compute_tip_force(fixtures, 0.102, -0.205, 0.0)[:3] == pytest.approx((-0.6, 1.5, 0.0))
    assert compute_tip_force(fixtures, 0.2, 0.0, 0.0)[:3] == pytest.approx((-3.0, 0.0, 0.0))
