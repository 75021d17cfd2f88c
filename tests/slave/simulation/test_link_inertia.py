"""Links of arms, against Pinocchio and Lagrange's equations by differences."""

import math

import numpy as np
import pytest

from slave.simulation.arm import ArmPlantConfig
from slave.simulation.link_inertia import LUMPS, build_links, compute_link_motion
from teleop.config.arm import BendingSectionConfig
from tests.estimator.kinematics.random_arms import (
    add_links,
    random_chain,
    random_coordinates,
    write_urdf,
)

GRAVITY = (1.0, -3.0, -9.0)


def build_chain(folder, rng, count):
    """Return links of a random chain with random pulleys, their radii, the arm and its URDF."""
    arm = add_links(rng, random_chain(rng, count))
    file = folder / "chain.urdf"
    file.write_text(write_urdf(arm))
    radius = rng.uniform(0.5, 2.0, count)
    config = ArmPlantConfig(
        np.diag(radius.clip(0.0, 1.0)).tolist(), urdf=file, base="base", tip="tip", gravity=GRAVITY
    )
    return build_links([config], radius), radius, arm, file.read_text()


def test_mass_forces_and_tips_of_50_random_chains_agree_with_pinocchio(tmp_path):
    pin = pytest.importorskip("pinocchio")
    pytest.importorskip("urdf_parser_py")
    rng = np.random.default_rng(3)
    for _ in range(50):
        n = int(rng.integers(1, 9))
        links, radius, arm, text = build_chain(tmp_path, rng, n)
        model = pin.buildModelFromXML(text)
        model.gravity.linear = np.array(GRAVITY)
        q, rate = random_coordinates(rng, arm), rng.normal(0.0, 3.0, n)
        data, q_pin, v_pin = model.createData(), pin.neutral(model), np.zeros(model.nv)
        columns = []
        for value, speed, coordinate in zip(q, rate, arm.coordinates, strict=True):
            joint = model.joints[model.getJointId(coordinate.name)]
            turn = [value] if joint.nq == 1 else [math.cos(value), math.sin(value)]
            q_pin[joint.idx_q : joint.idx_q + joint.nq] = turn
            v_pin[joint.idx_v] = speed
            columns.append(joint.idx_v)
        upper = np.triu(pin.crba(model, data, q_pin))
        reference = (upper + np.triu(upper, 1).T)[np.ix_(columns, columns)]
        force = pin.rnea(model, data, q_pin, v_pin, np.zeros(model.nv))[columns]
        pin.framesForwardKinematics(model, data, q_pin)
        frame, world = model.getFrameId("tip"), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pin.computeFrameJacobian(model, data, q_pin, frame, world)[:, columns]
        mass, driven, unit, tips = compute_link_motion(links, q * radius, rate * radius)
        assert mass * np.outer(radius, radius) == pytest.approx(reference, abs=1e-9)
        assert driven * radius == pytest.approx(force, abs=1e-9)
        assert tips[0] == pytest.approx(data.oMf[frame].translation, abs=1e-12)
        moves = unit * radius[:, None]
        assert pytest.approx(jacobian[:3], abs=1e-12) == (moves[0] + np.cross(moves[1], tips[0])).T
        assert pytest.approx(jacobian[3:], abs=1e-12) == moves[1].T


def walk_curves(links, q):
    """Return the lumps of curved sections in series [m], and their end, by short steps."""
    steps, turn, place, lumps = 400, np.eye(3), np.zeros(3), []
    for part, first in enumerate(links.joint[:-1]):
        x, y = q[first : first + 2] / steps
        step = np.array([[0, 0, x], [0, 0, y], [-x, -y, 0]])
        half = np.eye(3) + step / 2 + step @ step / 8
        for k in range(steps):
            middle = turn @ half
            turn = turn @ (np.eye(3) + step + step @ step / 2 + step @ step @ step / 6)
            if (k - steps // (2 * LUMPS)) % (steps // LUMPS) == 0:
                lumps.append((links.mass[part] / LUMPS, place))
            place = place + middle[:, 2] * links.length[part] / steps
    return lumps, place


def test_curved_sections_are_lumps_on_their_middle_line():
    """Kinetic energy and Lagrange's equations of what a numerical integration gives."""
    config = ArmPlantConfig(
        np.eye(4).tolist(),
        sections=(
            BendingSectionConfig("first", 0.3, 2.5, mass=1.2),
            BendingSectionConfig("second", 0.2, 2.5, mass=0.7),
        ),
    )
    links, q, rate = (
        build_links([config], np.ones(4)),
        np.array([1.1, -0.7, 0.4, 1.6]),
        [3, 1, -2, 4],
    )
    step = 1e-3

    def kinetic(at, speed):
        """Of the lumps, by differences of their places."""
        ahead, behind = (walk_curves(links, at + sign * 1e-4 * speed)[0] for sign in (1.0, -1.0))
        return sum(
            0.5 * mass * ((after - before) ** 2).sum() / 4e-8
            for (mass, after), (_, before) in zip(ahead, behind, strict=True)
        )

    speed = np.array(rate, float)
    mass, force, *_ = compute_link_motion(links, q, speed)
    assert 0.5 * speed @ mass @ speed == pytest.approx(kinetic(q, speed), rel=1e-4)
    slope = np.array(
        [
            (kinetic(q + step * axis, speed) - kinetic(q - step * axis, speed)) / (2.0 * step)
            for axis in np.eye(4)
        ]
    )
    ahead, behind = (
        compute_link_motion(links, q + s * step * speed, speed).mass for s in (1.0, -1.0)
    )
    lagrange = (ahead - behind) @ speed / (2.0 * step) - slope
    assert force == pytest.approx(lagrange, abs=1e-3 * np.abs(force).max())
    assert np.abs(force).max() > 0.05
    _, _, unit, tips = compute_link_motion(links, q, speed)
    assert tips[0] == pytest.approx(walk_curves(links, q)[1], abs=1e-6)
    ends = [[walk_curves(links, q + s * axis)[1] for s in (1e-4, -1e-4)] for axis in np.eye(4)]
    by_steps = [(ahead - behind) / 2e-4 for ahead, behind in ends]
    assert unit[0] + np.cross(unit[1], tips[0]) == pytest.approx(np.array(by_steps), abs=1e-6)
