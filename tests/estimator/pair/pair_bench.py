"""A pair of tendons by brute force: two chains of Coulomb beads, and a joint with dry friction.

Nothing here knows the law under test: the chains balance springs and beads, and the joint creeps
to where friction holds it. Tips are blocked, for a joint that hardly takes up travel.
"""

import math

import numpy as np

from estimator.pair.pair_model import PairRecord
from studies.brute_force.chain import Chain, Force, Position

PULLEY = 0.008  # [m], not the one that the estimator takes
LENGTH = 1.0  # [m]
AXIAL = 250.0  # EA [N]
COEFFICIENT = 0.18  # of friction
FIXED = math.radians(100.0)  # bend that the sheath always has
STIFFNESS = 7.0  # of the joint [N/rad]
JOINT_FRICTION = 0.8  # [N]
COMPLIANCE = LENGTH / AXIAL / PULLEY  # [rad/N]


def record(bend, *, neutral=0.0, samples=90, peak=1.0, pretension=5.0, noise=0.0, seed=0):
    """Return a record of two periods at a bend [rad] of the sheath."""
    time = np.linspace(0.0, 12.6, samples)
    command = peak * np.sin(time)
    tensions, tips = np.transpose(
        [_tendon(bend, way * command, pretension) for way in (1, -1)], (1, 0, 2)
    )
    angle = _joint((tips[0] - tips[1]) / STIFFNESS + neutral)
    unsure = np.random.default_rng(seed).normal(0.0, 1.0, (3, samples))
    return PairRecord(
        bend,
        time,
        command,
        angle + 0.01 * noise * unsure[0],
        tensions[0] + noise * unsure[1],
        tensions[1] + noise * unsure[2],
    )


def _tendon(bend, command, pretension):
    """Return the tensions [N] at both ends, shape (2, n); it is pulled to the pretension first."""
    sections = [(LENGTH, LENGTH / (bend + FIXED))]
    chain = Chain(sections, COEFFICIENT, AXIAL, beads=40)
    for tension in np.linspace(0.0, pretension, 9)[1:]:
        chain.move(Force(tension), Position(0.0))
    start = chain.travel[0]
    ends = []
    for travel in start + PULLEY * (command - command[0]):
        chain.move(Position(travel), Position(0.0))
        ends.append((chain.T_in, chain.T_out))
    return np.transpose(ends)


def _joint(free):
    """Return the angle of a joint that friction holds until it is overcome."""
    angle, now = [], 0.0
    for target in free:
        excess = STIFFNESS * (target - now)  # [N] on the joint
        if abs(excess) > JOINT_FRICTION:
            now += (excess - math.copysign(JOINT_FRICTION, excess)) / STIFFNESS
        angle.append(now)
    return np.array(angle)
