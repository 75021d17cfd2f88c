"""A session with an arm in space: hand, link, estimators and plant, all loops as they are."""

from contextlib import ExitStack

import numpy as np
import pytest

from estimator.kinematics.arm import prepare_arm
from estimator.kinematics.forward import compute_tip_pose
from slave.simulation.link_inertia import compute_link_motion
from slave.simulation.space_contacts import locate_surfaces, press_surface
from teleop.config.loading import load
from teleop.coupling import PassivityConfig
from teleop.session.config import RunConfig
from teleop.session.state_machine import Reason, State
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
            motion = compute_link_motion(rig._arm.links, travel, np.zeros(4))
            depth, _ = locate_surfaces(rig._arm.contacts, motion)
            surface = rig._arm.contacts.surfaces[0]
            rows["travel"].append(travel)
            rows["hand"].append([x for x, _ in session.master._device._hands])
            rows["felt"].append(np.array(session.master._force[:4]))
            rows["tip"].append(compute_tip_pose(arm, travel[:3] / radius[:3])[:3, 3])
            rows["pressed"].append(press_surface(surface, depth[0], depth[0], 1e-3)[0])
            rows["true"].append(rig.joint_forces)
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
    assert (felt[:300, 2] < -0.2).mean() > 0.95
    assert (felt[:, 2] < -0.2).mean() > 0.5  # while it rests there, doubt takes some of it
    untouched = record["engaged"] & (record["pressed"] == 0.0)
    untouched[2900:] = False
    assert np.abs(record["felt"][untouched][:, :3]).max() < 0.1


def test_the_force_stays_within_the_limits_of_the_hand(record):
    assert np.abs(record["felt"]).max() <= 2.5 + 1e-9
    grown = np.diff(np.abs(record["felt"]), axis=0)
    assert grown.max() <= 150.0 * 1e-3 * 1.5  # [N] a tick may last a little longer


BREAKS_S = 3.1  # the third tendon, after a rest
THREE = (
    *("master.device.reference.reach=0.4", "master.device.reference.rest=0.1"),
    f"slave.rig.effects=[{{type: broken_tendon, joint: 2, start: {BREAKS_S}}}]",
)


@pytest.fixture(scope="module")
def three_tendons():
    """What happens in each tick with three tendons a section, until one breaks; and the fault."""
    rows = []
    with ExitStack() as stack:
        session = Session(stack, THREE, file=ROOT / "configs" / "endoscope-three-tendons.yaml")
        rig, memory = session.slave._rig, session.slave.memory
        for tick in range(round(1000 * (BREAKS_S + 0.4))):
            session.tick()
            if memory.detected_fault:
                break
            if session.master.memory.session.state == State.ENGAGED:
                joints = [memory.joints[k] for k in range(4)]
                forces = [[getattr(j, name) for j in joints] for name in ("force", "low", "high")]
                travel = [joint.position for joint in joints], rig.joint_travel
                tension = [memory.tendons[i].tension for i in range(6)]
                rows.append((tick, rig.joint_forces, *forces, *travel, tension))
        fault = memory.detected_fault, memory.faulty_tendon, 1e-3 * tick - BREAKS_S
    return [np.array(column) for column in zip(*rows, strict=True)], fault


def test_forces_on_bends_of_three_tendons_are_inside_their_intervals(three_tendons):
    tick, true, force, low, high, travel, there, _ = three_tendons[0]
    known = (tick > 600) & (tick < 1000 * BREAKS_S)
    assert known.sum() > 1500
    assert ((low <= true) & (true <= high))[known].mean() > 0.999
    assert np.abs(true)[known].max() > 1.5  # [N]
    assert np.abs(force - true)[known].mean() < 0.5
    assert np.abs(travel - there)[known].max() < 2e-4  # [m]
    assert np.ptp(there[known], axis=0).min() > 5e-4


def test_three_tendons_stay_taut_and_do_not_fight(three_tendons):
    tick, *_, tension = three_tendons[0]
    least = tension.reshape(-1, 2, 3).min(axis=2)  # [N] at the housing; 0.3 are wanted
    engaged = (tick > 1000) & (tick < 1000 * BREAKS_S - 5)
    assert least[engaged].min() > 0.05
    assert np.median(least[engaged]) < 0.6
    assert least[engaged & (tick > 2750)].max() < 0.6  # at rest


def test_a_broken_tendon_of_three_is_found(three_tendons):
    reason, tendon, after = three_tendons[1]
    assert (reason, tendon) == (Reason.TENDON_BROKEN, 2)
    assert 0.0 < after < 0.3  # [s]


TENDONS = [f"slave.rig.joints.{k}.tendons.{side}" for k in range(4) for side in (0, 1)]
PRESS = (  # aside, then on a wall; by tendons that leave little in doubt
    "slave.rig.arms.0.contacts=[{type: plane, point: [0, 0, 0.063], stiffness: 2000}]",
    *(f"{tendon}.sheath.friction=0.02" for tendon in TENDONS),
    *("arms.0.friction=0", "slave.rig.arms.0.friction=0"),
    *("master.device.reference.reach=0.5", "master.device.reference.rest=0.05"),
    "master.device.reference.points=[[0, 0, 0, 0], [0.05, 0.05, -0.01, 0]"
    + 20 * ", [0.05, 0.05, 0.03, 0]"
    + "]",
    *("master.state_timeout=0.15", "slave.command_timeout=0.15"),
)
BALL = (
    *PRESS,
    "slave.rig.arms.0.contacts=[{type: ball, centre: [0.0125, 0.0125, 0.0745], radius: 0.015, "
    "stiffness: 20000, damping: 1.0}]",
)
RUB = (*BALL, *(f"{tendon}.sheath.friction=0.16" for tendon in TENDONS))
SOME_MS = 500  # ticks


def press_wall(pressed, round_trip, seconds):
    """Let a scripted hand press; hand (ticks, 4) [m], force in it (ticks, 4) [N], work [J]."""
    late = (f"master.delay_max={2.0 * round_trip + 0.2}", "master.device.engage_period=1e6")
    late = (*late, f"master.device.engage=[[{0.1 + round_trip}, 1e6]]")
    hands, felt, worked = [], [], []
    with ExitStack() as stack:
        session = Session(stack, (*pressed, *late), file=FILE, delay_s=round_trip / 2.0)
        master, coupled = session.master, np.zeros(4)
        for _ in range(round(1000 * (seconds + 2.0 * round_trip))):
            before = np.array([x for x, _ in master._device._hands])
            session.tick()
            hands.append([x for x, _ in master._device._hands])
            worked.append(coupled @ (hands[-1] - before))
            coupled = master._force[:4] - master.memory.local_force[:4]
            felt.append(master._force[:4].copy())
            for side in (master.memory.coupling, session.slave.memory.coupling):
                assert min(side.ports[k].credit for k in range(4)) >= -1e-9
        assert session.master.memory.session.state == State.ENGAGED
    assert np.cumsum(worked).max() < 4 * 2.0 * PassivityConfig().reserve / SCALE
    return np.array(hands), np.array(felt)


@pytest.mark.parametrize(
    ("pressed", "round_trip"),
    [
        (PRESS, 0.2),
        *(pytest.param(PRESS, late, marks=pytest.mark.slow) for late in (0.0, 0.05, 0.1, 0.3)),
        *(pytest.param(BALL, late, marks=pytest.mark.slow) for late in (0.0, 0.05, 0.1, 0.2, 0.3)),
    ],
)
def test_a_hand_comes_to_rest_on_what_it_meets_in_space_whatever_the_delay(pressed, round_trip):
    """With the default coupling: it presses, is pushed back, and takes no energy from it."""
    hands, felt = (rows[-SOME_MS:] for rows in press_wall(pressed, round_trip, 3.2))
    assert felt[:, 2].max() < -0.2  # [N] of the wall
    assert np.ptp(felt[:, :3], axis=0).max() < 0.3
    assert np.ptp(hands[:, :3], axis=0).max() < 0.5e-3


def test_a_hand_on_a_ball_does_not_cycle_where_friction_lets_the_tip_stick_and_slip():
    """Between single slips, whose times the processor's rounding decides, the force is still.

    A limit cycle of 10 Hz fills each quarter of a second with 0.3 N and more.
    """
    _, felt = press_wall(RUB, 0.0, 9.0)  # at rest after some 7 s
    windows = felt[-3000:, :3].reshape(12, 250, 3)
    swing = np.sort(np.ptp(windows, axis=1).max(axis=1))  # [N]
    assert swing[2] < 0.15
    assert windows[..., 2].mean() < -0.15
