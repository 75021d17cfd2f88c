"""A session with an arm in space: hand, link, estimators and plant, all loops as they are."""

from contextlib import ExitStack

import numpy as np
import pytest

from estimator.kinematics.arm import prepare_arm
from estimator.kinematics.forward import compute_tip_pose
from slave.simulation.space_contacts import locate_surfaces, press_surface
from teleop.config.loading import load
from teleop.session.config import RunConfig
from teleop.session.state_machine import State
from tests.root import ROOT
from tests.tick.session import Session

FILE = ROOT / "configs" / "notes-arm.yaml"
SECONDS = 5.2  # the hand has pressed the ball by then
SCALE = 0.25  # tip per hand, as in the config


@pytest.fixture(scope="module")
def record():
    """What happened in each tick, by name; arrays with a row for each tick."""
    shared = load(FILE, RunConfig, None)
    arm = prepare_arm(shared.arms[0].load_kinematics())[0]
    radius = np.diag(shared.arms[0].radii)
    rows: dict[str, list] = {name: [] for name in ("hand", "felt", "tip", "pressed", "true")}
    rows |= {"force": [], "low": [], "high": [], "engaged": [], "travel": []}
    with ExitStack() as stack:
        session = Session(stack, (), file=FILE)
        rig, memory = session.slave._rig, session.slave.memory
        for _ in range(round(SECONDS * 1000)):
            session.tick()
            travel = np.array([state.travel for state in rig._states])
            depth, _ = locate_surfaces(rig._arm.contacts, travel)
            surface = rig._arm.contacts.surfaces[0]
            a, b = rig._arm_state.tension.transpose(1, 0, 2)
            rows["travel"].append(travel)
            rows["hand"].append([x for x, _ in session.master._device._hands])
            rows["felt"].append(np.array(session.master._force[:4]))
            rows["tip"].append(compute_tip_pose(arm, travel[:3] / radius[:3])[:3, 3])
            rows["pressed"].append(press_surface(surface, depth[0], depth[0], 1e-3)[0])
            rows["true"].append((rig._arm.ratio * (a - b)).sum(axis=0))
            for name in ("force", "low", "high"):
                rows[name].append([getattr(memory.joints[k], name) for k in range(4)])
            rows["engaged"].append(int(session.master.memory.session.state) == State.ENGAGED)
    return {name: np.array(values) for name, values in rows.items()}


def test_the_tip_follows_the_hand_in_space(record):
    free = record["engaged"] & (record["pressed"] == 0.0)
    free[:600] = False
    wanted = record["tip"][500] + SCALE * (record["hand"] - record["hand"][500])[:, :3]
    free &= np.arange(len(free)) < 2900  # before the ball is met
    assert free.sum() > 2000
    assert np.abs(record["tip"] - wanted)[free].max() < 1.2e-3  # [m], on the way at 60 mm/s


def test_the_forces_on_all_joints_are_inside_their_intervals(record):
    """Of tendons that pass joints with friction, against the plant."""
    known = record["engaged"] & np.isfinite(record["force"]).all(axis=1)
    inside = (record["low"] <= record["true"]) & (record["true"] <= record["high"])
    assert inside[known].mean() > 0.999
    assert np.abs(record["true"])[known].max() > 8.0  # [N]
    assert np.abs(record["force"] - record["true"])[known].mean() < 0.6


def test_the_hand_feels_the_contact_where_the_tip_has_it(record):
    pressed = record["engaged"] & (record["pressed"] > 1.0)
    assert pressed.sum() > 300
    # the ball is beyond the tip: the hand is pushed back, along -z first of all
    felt = record["felt"][pressed][:, :3]
    assert (felt[:, 2] < -0.2).mean() > 0.9
    untouched = record["engaged"] & (record["pressed"] == 0.0)
    untouched[2900:] = False
    assert np.abs(record["felt"][untouched][:, :3]).max() < 0.1


def test_the_force_stays_within_the_limits_of_the_hand(record):
    assert np.abs(record["felt"]).max() <= 2.5 + 1e-9
    grown = np.diff(np.abs(record["felt"]), axis=0)
    assert grown.max() <= 150.0 * 1e-3 * 1.5  # [N] a tick may last a little longer
