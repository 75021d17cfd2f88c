"""Hands mapped to joints: power, limits of the force, and what each map does."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.kinematics.arm import prepare_arm
from estimator.kinematics.forward import compute_tip_pose
from estimator.structs import to_struct, view_struct
from master import axis_map, loop
from master.axis_map import AxisMapper, VelocityMap
from master.config import MasterConfig
from master.device import HandState
from master.feedback import FeedbackConfig
from master.hand_input import HandInput, fill_hand_input
from master.mapping_config import (
    AxisMapConfig,
    MappedJointConfig,
    SpaceHandConfig,
    SpaceMapConfig,
)
from master.operator import OperatorConfig
from master.settings_record import SettingsRecord
from master.space_map import SpaceMapper
from teleop.config.arm import ArmConfig
from teleop.coupling import Bilateral
from teleop.messages.messages import Command, Hand, SlaveState
from teleop.session.state_machine import State
from tests.master.records import message_records
from tests.root import ROOT

DT = 1e-3
SCALE = 0.25
LEVER = 0.05
RADII = np.array([0.005, 0.004, 0.006, 0.005])
ARM = ArmConfig(radii=np.diag(RADII).tolist(), urdf=ROOT / "configs" / "notes-arm.urdf", tip="tip")
HAND = SpaceHandConfig(axes=("x", "y", "z", "grip"))


class SpaceRun:
    """A hand that moves an arm as the master does, but without the rest of the master."""

    def __init__(self, hand=HAND, start=(0.0,) * 4):
        self.arm = ARM.load_kinematics()
        self.mapper = SpaceMapper(SpaceMapConfig(hands=(hand,)), [self.arm], [RADII])
        self.axes, self.scale = len(hand.axes), SCALE
        self.memories = loop.init_master(self.axes, 0, self.mapper.joints)
        self.memory = view_struct(self.memories)
        self.memory.operator.tip[:4] = RADII * start
        self.hands = HandInput.array()
        self.travel = np.zeros(4)

    def tick(self, position, engaged=True):
        """Return the matrix of the tick and how far it moved the mapped hand."""
        self.memory.session.state = int(State.ENGAGED if engaged else State.READY)
        fill_hand_input(self.hands, HandState(tuple(position), (0.0,) * self.axes, engaged))
        self.mapper.step(self.hands, self.memories, self.scale, DT)
        travel = self.mapper.mapped_hands["position"][0, :4].copy()
        moved, self.travel = travel - self.travel, travel
        self.memory.operator.tip[:4] += self.scale * moved
        maps = self.mapper.maps[0]  # to the device's own forces and torques
        return maps["matrix"][:4, : self.axes] * maps["lever"][: self.axes], moved

    @property
    def tip(self):
        angles = np.array(self.memory.operator.tip[:3]) / RADII[:3]
        return compute_tip_pose(prepare_arm(self.arm)[0], angles)[:3, 3]


def test_the_tip_moves_as_the_hand_scaled_and_turned():
    turned = SpaceHandConfig(axes=("x", "y", "z", "grip"), registration=(0.0, 0.0, np.pi / 2))
    for config, turn in ((SpaceHandConfig(axes=turned.axes), np.eye(3)), (turned, TURNED)):
        run = SpaceRun(config)
        run.tick(np.zeros(4))
        start = run.tip
        for share in np.linspace(0.0, 1.0, 500):
            hand = np.array([0.03, -0.02, 0.016, 0.004]) * share
            run.tick(hand)
        assert run.tip - start == pytest.approx(SCALE * turn @ hand[:3], abs=2e-5)
        assert run.memory.operator.tip[3] == pytest.approx(0.004)  # the gripper: grip_scale 1


TURNED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("axes", "scales", "dead_bands"),
    [
        (("x", "y", "z", "grip"), (), ()),
        (("x", "y", "z", "roll", "pitch", "yaw", "grip"), (), ()),
        (("grip", "z", "x", "y"), (0.5, -1.0, 2.0, 1.0), (0.0, 0.01, 0.0, 0.0)),
        (("x", "y", "z", "yaw", "grip"), (1.0, 1.0, 1.0, -0.5, 1.0), (0.0, 0.0, 0.0, 0.1, 0.0)),
    ],
)
def test_a_map_creates_no_energy_through_limits_and_singular_postures(axes, scales, dead_bands):
    """Hand and joints have the same power in every tick, for any force: to rounding.

    Nor do a clutch, other scales and another registration give any.
    """
    rng = np.random.default_rng(3)
    run = SpaceRun(
        SpaceHandConfig(
            axes=axes, scales=scales, dead_bands=dead_bands, registration=(0.4, -0.7, 1.1)
        )
    )
    hand, before = np.zeros(len(axes)), None
    largest = slowed = 0.0
    for i in range(3000):
        hand = hand + rng.normal(0.0, 2e-4, len(axes)) + 3e-4 * np.sin(i / 500.0)
        if i % 250 == 0:
            run.scale = rng.uniform(0.1, 0.5)
        matrix, moved = run.tick(hand, engaged=i % 700 > 40)
        force = rng.normal(0.0, 5.0, 4)
        if before is not None:
            work = (matrix.T @ force) * (hand - before)
            # the device's angles are turned by their rates, and a dead band ends by its slope, both
            # right to second order
            second_order = 0.05 if any(dead_bands) else 1e-3 if "yaw" in axes else 0.0
            tolerance = 1e-14 + second_order * np.abs(work).sum()
            assert work.sum() == pytest.approx(force @ moved, abs=tolerance)
        before = hand.copy()
        largest = max(largest, np.abs(np.array(run.memory.operator.tip[:3]) / RADII[:3]).max())
        slowed += run.mapper._hands["ease"][0, :3].min() < 0.9
    assert largest > 1.19  # a joint was at its limit
    assert largest < 1.2 + 1e-9
    assert slowed > 100


def test_a_joint_comes_to_its_limit_without_a_step_of_the_force():
    """Out to the limit of the elbow and beyond, trembling there, and back."""
    run = SpaceRun()
    time = np.arange(0.0, 6.0, 2.0 * DT)
    way = np.interp(time, [0.0, 2.0, 4.0, 6.0], [0.0, 0.22, 0.22, 0.0])
    way += np.where((time > 2.0) & (time < 4.0), 0.3e-3 * np.sin(2.0 * np.pi * 9.0 * time), 0.0)
    felt, angles = [], []
    for x in way:
        matrix, _ = run.tick(np.array([x, 0.3 * x, -0.2 * x, 0.0]))
        felt.append(matrix.T @ np.array([1.0, -0.7, 0.5, 0.0]))
        angles.append(run.memory.operator.tip[1] / RADII[1])
    felt = np.array(felt)
    assert 1.195 < max(angles) <= 1.2
    assert angles[-1] < 0.0  # it came back with the hand
    assert np.abs(np.diff(felt[2:], axis=0)).max() < 0.12 * np.abs(felt).max()
    trembling = felt[(time > 2.1) & (time < 4.0)]
    assert np.abs(np.diff(trembling, axis=0)).max() < 0.02 * np.abs(felt).max()


def test_each_axis_of_a_hand_has_a_scale_and_a_dead_band():
    hand = SpaceHandConfig(axes=("x", "y", "z"), scales=(-0.5, 1.0, 2.0), dead_bands=(0, 0.01, 0))
    run = SpaceRun(hand)
    run.tick(np.zeros(3))
    start = run.tip
    for share in np.linspace(0.0, 1.0, 500):
        matrix, _ = run.tick(np.array([0.02, 0.009, 0.01]) * share)
    assert run.tip - start == pytest.approx(SCALE * np.array([-0.01, 0.0, 0.02]), abs=2e-5)
    assert not matrix[:, 1].any()  # no force where nothing moves


def test_nothing_moves_while_not_engaged_and_nothing_jumps_after():
    run = SpaceRun()
    for share in np.linspace(0.0, 1.0, 50):
        run.tick(np.full(4, 0.01 * share))
    tip = run.tip
    for share in np.linspace(1.0, -3.0, 50):  # clutched out: the hand is elsewhere afterwards
        matrix, moved = run.tick(np.full(4, 0.01 * share), engaged=False)
        assert not matrix.any()
        assert not moved.any()
    run.tick(np.full(4, -0.03))
    assert run.tip == pytest.approx(tip, abs=1e-9)


def test_locked_axes_and_missing_rotations_move_nothing():
    run = SpaceRun(SpaceHandConfig(axes=("x", "y", "z"), lock=("y",)))
    start = run.tip
    for share in np.linspace(0.0, 1.0, 200):
        run.tick(np.array([0.0, 0.05, 0.0]) * share)
    assert run.tip == pytest.approx(start, abs=1e-12)


@given(
    joint=st.builds(
        MappedJointConfig,
        axis=st.integers(0, 1),
        turns=st.booleans(),
        scale=st.sampled_from([-2.0, 0.5, 1.0]),
        dead_band=st.sampled_from([0.0, 0.002]),
        range=st.just((-0.02, 0.03)),
    ),
    way=st.lists(st.floats(-0.04, 0.04), min_size=2, max_size=20),
)
def test_axes_are_mapped_with_their_slopes(joint, way):
    """The matrix is the slope of the motion, so the power is the same at both ends."""
    mapper = AxisMapper(AxisMapConfig(joints=(joint,)), LEVER)
    hands = HandInput.array()

    def move(x):
        position = [0.0, 0.0]
        position[joint.axis] = x
        fill_hand_input(hands, HandState(tuple(position), (0.0, 0.0), True))
        mapper.step(hands, hands, 1.0, DT)
        return mapper.mapped_hands["position"][0, 0], mapper.maps["matrix"][0, 0, joint.axis]

    for x in way:
        step = 1e-8
        slope = (move(x + step)[0] - move(x - step)[0]) / (2.0 * step)
        lever = LEVER if joint.turns else 1.0  # a torque counts as a force at it
        assert move(x)[1] * lever == pytest.approx(slope, abs=1e-4)
    assert move(0.0)[0] == 0.0


def test_the_force_of_a_mapped_axis_ends_with_its_range_without_a_step():
    joint = MappedJointConfig(axis=0, range=(-0.02, 0.03))
    mapper = AxisMapper(AxisMapConfig(joints=(joint,)), LEVER)
    hands, gains, travels = HandInput.array(), [], []
    for x in np.linspace(-0.04, 0.04, 801):
        fill_hand_input(hands, HandState((x,), (0.0,), True))
        mapper.step(hands, hands, 1.0, DT)
        gains.append(mapper.maps["matrix"][0, 0, 0])
        travels.append(mapper.mapped_hands["position"][0, 0])
    assert np.abs(np.diff(gains)).max() < 0.06  # of 1, in a tenth of a millimetre
    assert (min(gains), max(gains)) == (0.0, 1.0)
    assert (travels[0], travels[-1]) == pytest.approx((-0.019, 0.0285))


matrices = st.lists(st.floats(-2.0, 2.0), min_size=12, max_size=12)
forces = st.lists(st.floats(-50.0, 50.0), min_size=4, max_size=4)


@given(matrices, forces, forces, st.floats(1e-4, 0.05))
def test_forces_on_the_hand_stay_in_bounds_and_are_felt_by_the_joints(matrix, last, force, dt):
    """Whatever the map: size, length and growth; and the force stays M^T of one along y."""
    config, total_max = FeedbackConfig(), 4.0
    velocity_map = view_struct(VelocityMap.array())
    velocity_map.is_active = True
    velocity_map.matrix[:4, :3] = np.reshape(matrix, (4, 3))
    M = np.array(velocity_map.matrix)
    last, joint_force = np.append(last, np.zeros(4)), np.append(force, np.zeros(4))
    size = max(np.abs(M.T @ last).max() / 2.5, np.linalg.norm(M.T @ last) / total_max, 1.0)
    last /= size  # as it left the last tick
    axis_map.limit_joint_force(
        to_struct(config), total_max, velocity_map, last, joint_force, 3, 4, dt
    )
    out = np.zeros(8)
    axis_map.compute_hand_force(velocity_map, joint_force, 3, 4, out)
    assert out == pytest.approx(M.T @ joint_force)
    assert np.abs(out).max() <= config.limit + 1e-9
    assert np.linalg.norm(out) <= total_max + 1e-9
    grown = np.abs(out) - np.abs(M.T @ last)
    assert (grown <= config.slew * min(dt, 0.005) + 1e-9).all()


class RenderRun(SpaceRun):
    """The same with the rest of the master, and a slave that tells forces on the joints [N]."""

    def __init__(self, hand=HAND):
        super().__init__(hand)
        self.states, self.commands = message_records(SlaveState), message_records(Command)
        self.now, self.ticks, self.force = 10**18, 0, np.zeros(8)

    def render(self, config, hand, forces):
        """Run a tick; return how far it moved the mapped hand."""
        self.now, states, travel = self.now + 10**6, self.states, self.travel
        engage = self.ticks > 20
        fill_hand_input(self.hands, HandState(tuple(hand), (0.0,) * self.axes, engage))
        states["state"] = int(State.READY if self.ticks < 22 else State.ENGAGED)
        states["sender"], states["joints"] = 7, 4
        states["echo_stamp_ns"] = states["stamp_ns"] = self.now - 10**6
        for name, width in (("force", 0.0), ("force_low", -0.5), ("force_high", 0.5)):
            states[name][0, :4] = forces + width
        self.mapper.step(self.hands, self.memories, config.operator.position_scale, DT)
        self.travel = self.mapper.mapped_hands["position"][0, :4].copy()
        settings = SettingsRecord(config, Bilateral()).records
        given = loop.TickInput(DT, self.now, True, 10**6)
        inputs = settings, self.memories, self.hands, self.mapper.mapped_hands, states, given
        loop.compute_command(*inputs, self.commands)
        loop.compute_force(*inputs, self.mapper.maps, False, self.force)
        self.ticks += 1
        return self.travel - travel


def test_torques_in_the_hand_have_limits_of_their_own_and_do_their_work():
    """On the axes that turn, in newton metres: size, growth, and power with the joints'."""
    axes = ("x", "y", "z", "roll", "pitch", "yaw", "grip")
    run, config = RenderRun(SpaceHandConfig(axes=axes)), MasterConfig()
    hand, largest, turnover = np.zeros(7), np.zeros(7), 0.0
    for i in range(400):
        before, last, joint_force = hand, run.force.copy(), np.array(run.memory.joint_force[:4])
        hand = 0.05 * np.sin(0.01 * i * np.array([0.2, 0.3, 0.2, 1.0, 1.3, 0.7, 0.1]))
        moved = run.render(config, hand, np.array([30.0, -20.0, 40.0, 0.0]))
        work, force = last[:7] @ (hand - before), run.force
        tolerance = 0.02 * np.abs(last[:7]) @ np.abs(hand - before)
        assert work == pytest.approx(joint_force @ moved, abs=tolerance)
        largest, turnover = np.maximum(largest, np.abs(force[:7])), turnover + abs(work)
        grown = np.abs(force) - np.abs(last)
        assert grown[3:6].max() <= config.force.slew * config.gate.torque_lever * DT + 1e-12
    rotations = largest[3:6].max()
    limit = config.force.limit * config.gate.torque_lever
    assert 0.5 * limit < rotations <= limit + 1e-12
    assert turnover > 1e-4
    hand_message = message_records(Hand)
    loop.fill_hand_message(run.memories, run.hands, 0, 0, hand_message)
    assert (hand_message["force"][0] == force).all()  # as the device has them


def test_what_the_joints_are_said_to_feel_is_what_the_hand_gets():
    """From the first tick on, whatever slew, limits and gate take away: the ledger counts it.

    Each force is held while the map changes in a tick, which the ledger need not see.
    """
    run, config, rng = RenderRun(), MasterConfig(), np.random.default_rng(5)
    ports, counted, given_out, turnover = run.memories["coupling"]["ports"], 0.0, 0.0, 0.0
    hand, most, force = np.zeros(4), 0.0, run.force
    for i in range(400):
        before, hand = hand, 0.01 * np.sin(0.01 * i * np.array([1.0, 1.3, 0.7, 0.5]))
        if i == 200:
            config = MasterConfig(operator=OperatorConfig(position_scale=0.4))
        if i % 50 == 0:
            torque = 8.0 * rng.uniform(-1.0, 1.0, 4)
        work = force[:4] @ (hand - before)
        total = (ports["taken_out"] - ports["put_in"]).sum()
        run.render(config, hand, torque)
        total = (ports["taken_out"] - ports["put_in"]).sum() - total
        scale = config.operator.position_scale
        counted, given_out = counted + total * config.force.scale / scale, given_out + work
        turnover += abs(work)
        matrix = run.mapper.maps["matrix"][0, :4, :4]
        told = matrix.T @ np.array(run.memory.joint_force[:4])
        assert (np.abs(told) <= np.abs(force[:4]) + 1e-12).all()
        if not np.array(run.memory.local_force).any():
            assert told == pytest.approx(force[:4], abs=0.16)  # of one tick's growth
        most = max(most, np.abs(force).max())
    assert most > 0.5
    assert counted == pytest.approx(given_out, abs=0.02 * turnover)
