"""Joints that share tendons: the stages, the friction of passed joints, and a simulated arm."""

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from estimator.fitting import MeasuredValue
from slave.arm_estimate import build_routing
from slave.calibration import calibration_file, command, initialisation, procedure
from slave.calibration.figure import draw_figure
from slave.calibration.guide_friction import PosturedDrag, fit_guide_friction
from slave.calibration.posture import plan_stages
from slave.calibration.procedure_run import CalibrationInterrupted, generate_fast_ticks
from slave.calibration.procedure_state import (
    JointConstants,
    JointReadings,
    Phase,
    ProcedureState,
    StopContact,
)
from slave.config import SlaveConfig, load_arms
from slave.simulation.arm import ArmPlantConfig
from slave.tendon_config import TendonConfig
from teleop.config.arm import ArmConfig
from teleop.errors import UsageError
from tests.slave.calibration.calibration_bench import (
    EA,
    GATE,
    LENGTH,
    QUICK,
    HousingOnly,
    but,
    calibrated,
    joint,
    rig_config,
)

PAIRS = ((0, 1), (2, 3), (4, 5))
RATIO = np.array([[1.0, 0.0, 0.0], [0.8, 1.0, 0.0], [-0.8, 0.8, 1.0]])
RADII = ((0.005, 0.0), (0.004, 0.005))
K, MU, WRAP = 0.7, 0.12, 0.2
SHORT = but(QUICK, drag_time=1.0)
RATE = 250.0  # [Hz]


# --- the stages


def test_a_tendon_is_pulled_while_the_joints_it_passes_are_at_the_stops_it_presses_them_onto():
    place, held, pulled = np.zeros(3), np.zeros(3, dtype=bool), []
    for stage in plan_stages(RATIO, PAIRS, range(3), 2, together=False):
        (j, *_), end = stage.joints, 1.0 - 2.0 * (stage.side % 2)
        if stage.phase is Phase.MOVE:
            behind = [k for k in range(j + 1, 3) if RATIO[k, j]]
            assert not held[behind].any()  # its tendon would resist
            place[j], held[j] = stage.target, abs(stage.target) == 1.0
        elif stage.phase is Phase.SEEK:
            passed = np.flatnonzero(RATIO[j, :j])
            assert place[passed] == pytest.approx(np.sign(RATIO[j, passed]) * end)
            place[j], held[j] = end, True
            pulled.append((j, stage.side))
        elif stage.phase is Phase.DRAG:
            assert place[j] * end < 0.0
            place[j] = stage.target
    assert pulled == [(j, side) for j in range(3) for side in range(2)]
    assert not place.any()


def test_drags_of_a_joint_bend_each_passed_joint_in_some_posture_only():
    bends, place = set(), np.zeros(3)
    for stage in plan_stages(RATIO, PAIRS, range(3), 1, together=False):
        if stage.phase is Phase.MOVE:
            place[stage.joints[0]] = stage.target
        elif stage.phase is Phase.DRAG and stage.joints == (2,):
            bends.add(tuple(np.abs(place[:2])))
    assert bends == {(1.0, 1.0), (1.0, 0.0), (0.0, 0.0)}


@pytest.mark.parametrize(
    ("ratio", "joints", "chosen", "together", "said"),
    [
        (RATIO, PAIRS, [0, 1, 2], True, "--together: these joints share tendons"),
        (RATIO, PAIRS, [0, 2], False, "--joint 3: .* pass joint 2.*: add --joint 2"),
        (RATIO.T, PAIRS, [0, 1, 2], False, "arms.radii: .* before their own only"),
        (RATIO, ((0,), (1, 2), (3, 4)), [0, 1, 2], False, "joint 1 has a single tendon"),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_moves(ratio, joints, chosen, together, said):
    with pytest.raises(UsageError, match=said):
        plan_stages(ratio, joints, chosen, 2, together)


def test_a_rig_with_rows_for_single_tendons_is_not_calibrated():
    arm = ArmConfig(((0.005, 0.0), (-0.002, 0.005), (-0.003, -0.005)))
    rig = HousingOnly(rig_config(joint(K), joint(K, tendons=1)))
    with pytest.raises(UsageError, match=r"rows for single tendons .* tip blocked"):
        initialisation.initialise(
            rig, SlaveConfig(gate=GATE), generate_fast_ticks(RATE), 0, arms=[arm]
        )


@pytest.mark.parametrize(("tension", "left"), [(8.0, 0.004), (0.3, -0.002)])
def test_a_posture_that_is_not_reached_ends_it(tension, left):
    """An obstacle before the stop, or a stop that is no longer there."""
    stop = StopContact(0.005, 0.5, 1e-4)
    memory = ProcedureState(
        phase=Phase.MOVE, stops=(stop, stop), easing=True, lane=left, hold=8.0,
        tension=(tension, 0.2), origin=(0.0, 0.0), cells=(), blocked=(0.0, 0.0),
    )  # fmt: skip
    readings = JointReadings((tension, 0.2), (0.0, 0.0), (0.0, 0.0))
    constants = JointConstants(1, (2e-4, 2e-4), is_staged=True)
    targets, memory = procedure.step(QUICK, constants, memory, readings, 1e-3)
    assert memory.refusal.startswith("joint 1: posture not reached: ")
    assert "free the tip" in memory.refusal
    assert targets == (0.0, 0.0)


# --- friction of passed joints from sums


def draw_drags(mu, gains, noise, seed):
    random = np.random.default_rng(seed)
    bends = np.array([[2.0, 0.0], [2.1, 0.1], [0.4, 0.0]])
    more = np.array([[2.0, 2.2], [2.0, 0.6], [0.6, 0.6]])
    for m, table in ((1, bends), (2, more)):
        for bend in table:
            for side in range(2):
                total = 1.4 + 0.1 * m + bend @ mu + gains[m - 1] * (1 - 2 * side)
                total += random.normal(0.0, noise)
                yield PosturedDrag(m, side, MeasuredValue(total, noise), np.append(bend, 0.0))


def test_mu_of_each_joint_and_k_of_the_sheaths_lie_within_two_standard_uncertainties():
    mu, inside = np.array([0.12, 0.05]), []
    for seed in range(40):
        fit = fit_guide_friction(list(draw_drags(mu, (0.004, -0.003), 0.003, seed)), 0.002)
        for found, true in ((fit.friction[0], 0.12), (fit.friction[1], 0.05), (fit.sums[1], 1.5)):
            inside.append(abs(found.value - true) < 2.0 * found.uncertainty)
            assert found.value == pytest.approx(true, abs=0.01)
    assert np.mean(inside) > 0.9


def test_drags_of_one_posture_tell_nothing_and_contradictions_are_said():
    drags = list(draw_drags(np.array([0.1, 0.1]), (0.0, 0.0), 0.001, 1))
    assert "too few postures" in fit_guide_friction(drags[-2:], 0.002).remark
    assert fit_guide_friction(drags, 0.002).remark == ""
    wrong = MeasuredValue(drags[0].total.value + 0.2, 0.003)
    drags[0] = drags[0]._replace(total=wrong)
    assert "disagree" in fit_guide_friction(drags, 0.002).remark


# --- an arm of two joints


def arm_rig():
    body = {"stops": (-0.003, 0.003), "friction": 0.1}
    each = joint(K, noise=0.02, nodes=10, body=body)
    plant = ArmPlantConfig(radii=RADII, friction=MU, wrap=WRAP)
    return but(rig_config(each, each, period=1.0 / RATE), arms=(plant,))


class Observed(HousingOnly):
    """A rig of which the largest tension of tendons at rest or following is kept."""

    def __init__(self):
        super().__init__(arm_rig())
        self.moving, self.strained = 0, 0.0

    def follow(self, progress):
        self.moving = progress.joint - 1
        if self.moving == 0 and progress.phase is not Phase.RELAX:
            self.strained = max(self.strained, self.seen[-1].proximal_tension[2:].max())


@cache
def calibrate_arm():
    rig = Observed()
    wrong = ArmConfig(radii=RADII, friction=1.3 * MU, wrap=WRAP)
    config = SlaveConfig(rig=arm_rig(), gate=GATE, initialise=SHORT)
    result = initialisation.initialise(
        rig, dataclasses.replace(config, initialise=but(SHORT)), generate_fast_ticks(RATE), 0,
        progress=rig.follow, arms=[wrong],
    )  # fmt: skip
    return rig, result


def test_an_arm_is_calibrated_with_the_friction_of_its_passed_joint():
    _, result = calibrate_arm()
    for direction in result.calibration.directions:
        assert abs(direction.K.value - K) < 2.0 * direction.K.uncertainty
        stiffness, true = direction.stiffness_per_length, EA / LENGTH
        assert abs(stiffness.value - true) < 2.0 * stiffness.uncertainty < 0.05 * true
    (guide,) = result.calibration.guides
    assert guide.joint == 1
    assert abs(guide.friction.value - MU) < 2.0 * guide.friction.uncertainty
    assert guide.friction.value == pytest.approx(MU, rel=0.1)
    assert result.calibration.ranges == pytest.approx((0.006, 0.006), abs=5e-4)
    assert result.calibration.remark == ""
    report = "\n".join(command.format_report(result, Path("arm.yaml")))
    assert f"joint 1: friction of the tendons that pass it {guide.friction.value:.4f}" in report
    assert len(draw_figure(result.record, result.calibration).axes) == 4


def test_a_session_with_the_file_uses_the_friction_of_its_passed_joints(tmp_path):
    path = tmp_path / "arm.yaml"
    entry = calibration_file.GuideFriction(
        2, calibration_file.ValueWithUncertainty(0.21, 0.01), 0.09
    )
    tendons = (TendonConfig(effective_friction=0.5),) * 8
    calibration_file.save(
        path, calibration_file.Calibration(rig="bench", tendons=tendons, guides=(entry,))
    )
    arms = (ArmConfig(radii=RADII, friction=0.1, friction_error=0.3),) * 2
    first, second = load_arms(SlaveConfig(calibration=path), arms)
    assert (first.friction, first.friction_error) == ((0.1, 0.21), 0.09)
    assert (second.friction, second.friction_error) == ((0.1, 0.1), 0.3)
    assert build_routing(PAIRS[:2], [but(first, friction=(0.3, 0.21))]).friction[2, 0] == 0.3


def test_tendons_that_pass_the_moving_joint_follow_it_without_strain():
    rig, result = calibrate_arm()
    assert rig.strained < 4.0  # [N]
    record = result.record
    first = (record.phase[:, 0] == Phase.SEEK) & (record.side[:, 0] == 1)
    tension = record.tension[first][:, 2:]
    assert np.median(tension, axis=0).min() > 0.05  # nor slack
    last = result.samples[-1].proximal_tension
    assert (last < 2.0).all()
    assert abs(rig.rig.joint_travel).max() < 1e-3  # in mid-range


def test_interrupted_it_lowers_the_tensions_of_held_joints_too():
    rig, done = Observed(), []

    def stopped():
        held = bool(rig.seen) and rig.moving == 1 and rig.seen[-1].proximal_tension[0] > 7.0
        done.append(held)
        return "SIGINT: stopped" if held and sum(done) > 50 else ""

    with pytest.raises(CalibrationInterrupted, match="SIGINT"):
        calibrated(
            rig, but(SHORT, stretch_time=0.1), rate_hz=RATE, stopped=stopped, progress=rig.follow,
            ratio=rig.rig._arm.ratio[:, 0],
        )  # fmt: skip
    assert (rig.seen[-1].proximal_tension < 1.5).all()
    assert np.ptp(np.array(rig.written[-10:]), axis=0).max() == 0.0
