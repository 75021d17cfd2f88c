"""Joints that follow commands on the simulated rig, which shares no equation with the model."""

import math

import numpy as np
import pytest

from slave.control import ControlConfig
from slave.simulation.environment import WallConfig
from studies.testbed.control_bench import (
    CONFIG,
    build_joint,
    build_sine,
    build_stairs,
    follow,
    hold_still,
)

OFF = ControlConfig(compensation=0.0)
TOO_MUCH, TOO_LITTLE = (1.02, 1.03), (0.98, 0.97)  # of K and EA in the model, over the truth
MOTIONS = {
    "sine": build_sine(0.006, 0.25),
    "staircase": build_stairs((0.006, 0.003, 0.0, -0.005), 0.005, 0.15),
}


def loaded(K, **settings):
    """Return a joint whose return spring asks for about 5 N at the housing."""
    return build_joint(K, spring=900.0 * math.exp(-K), **settings)


def times_smaller(joints, commands, seconds, errors):
    """Return by how much the error is smaller with compensation, RMS and largest, by joint."""
    without = follow(joints, commands, seconds, OFF, errors=errors)
    made_up = follow(joints, commands, seconds, errors=errors)
    return [np.divide(without.error(k), made_up.error(k)).tolist() for k in range(len(joints))]


@pytest.mark.parametrize(
    ("K", "errors", "motion"),
    [
        (0.8, TOO_LITTLE, "staircase"),
        *(
            pytest.param(K, errors, motion, marks=pytest.mark.slow)
            for K, errors, motion in (
                (0.8, TOO_LITTLE, "sine"), (0.4, TOO_MUCH, "sine"), (1.2, TOO_LITTLE, "staircase")
            )
        ),
    ],
)  # fmt: skip
def test_the_tracking_error_of_a_joint_is_at_least_five_times_smaller(K, errors, motion):
    ((rms, most),) = times_smaller([loaded(K)], [MOTIONS[motion]], 3.5, errors)
    assert rms > 10.0
    assert most > 5.0


@pytest.mark.slow
def test_a_joint_of_one_tendon_is_made_up_for_too():
    alone = build_joint(0.4, spring=600.0, tendons=1, pretension=2.0)
    steps = build_stairs((0.004, 0.002, 0.006, 0.0), 0.005, 0.2)
    ((rms, most),) = times_smaller([alone], [steps], 3.5, TOO_LITTLE)
    assert rms > 5.0
    assert most > 5.0


@pytest.mark.parametrize(
    "K", [0.8, *(pytest.param(K, marks=pytest.mark.slow) for K in (0.02, 1.6))]
)
def test_at_rest_nothing_hunts_whatever_the_friction(K):
    record = follow([build_joint(K, spring=100.0)], [hold_still], 2.0)
    assert np.abs(record.travel).max() < 5e-6
    path = np.abs(np.diff(record.motor[1000:], axis=0)).sum(axis=0)
    assert path.max() < 1e-4  # [m] in a second, of noise and all


@pytest.mark.parametrize("K", [1.2, pytest.param(0.4, marks=pytest.mark.slow)])
def test_the_slack_side_tendon_stays_taut_at_a_low_tension(K):
    record = follow([loaded(K)], [MOTIONS["sine"]], 4.0)
    least = record.tension[200:].min(axis=1)
    assert least.min() > 0.1
    assert abs(np.median(least) - CONFIG.slack_side_tension) < CONFIG.slack_side_band
    assert np.quantile(least, 0.9) < 3.0 * CONFIG.slack_side_tension


def test_against_a_wall_the_tension_stops_at_its_limit_and_the_joint_comes_back():
    wall = WallConfig(position=0.003, stiffness=5e4)
    record = follow([build_joint(0.8, environment=wall)], [MOTIONS["sine"]], 4.0)
    assert record.tension.max() < CONFIG.tension_max + 1.0
    assert record.tension[500:1500, 0].max() > CONFIG.tension_max - 1.0
    free = record.asked[:, 0] < 0.0025
    assert np.abs(record.travel - record.asked)[free].max() < 5e-4


def test_engaging_moves_no_joint_whatever_its_tendons_are_pretensioned_with():
    for pretension in (0.2, 3.0):
        record = follow([build_joint(0.8, pretension=pretension)], [hold_still], 1.0)
        assert np.abs(record.motor[0]).max() == 0.0
        assert np.abs(record.travel).max() < 3e-5
