"""The slave on the simulated rig: what gate, fault detection and monitor do for a session."""

import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from slave import loop
from slave.calibration.monitor import Advice
from slave.config import SlaveConfig, TendonConfig, load_tendon_configs
from slave.gate import GateConfig
from slave.rigs.replayed_data import ReplayedRigConfig
from slave.rigs.simulated import SimulatedRig, SimulatedRigConfig
from slave.simulation.effects.friction import FrictionStep
from slave.simulation.effects.sensors import StuckCell
from slave.simulation.environment import FreeConfig, TissueConfig, WallConfig
from studies.testbed.control_bench import build_joint
from teleop.config.loading import load
from teleop.messages.messages import MAX_JOINTS, Command, SlaveState
from teleop.session.state_machine import Reason, State
from tests.slave.slave_bench import DT, SlaveBench

GATE = GateConfig(displacement_min=-0.05, displacement_max=0.05)
CONFIGS = Path(__file__).parents[2] / "configs"


class Run(NamedTuple):
    """A session, a row a tick, until its end or its first fault."""

    bench: SlaveBench
    time: float  # [s] when it ended
    tension: np.ndarray  # [N] true, at the housing, shape (n, tendons)
    behind: np.ndarray  # [m] of the motors, by their encoders, shape (n, tendons)
    advice: list[Advice]  # that the tick went by
    states: list[SlaveState]  # what the slave answered
    tip: np.ndarray  # [m] of the first joint, as the coupling lets it go


def run(config, position, seconds, spoiled=lambda _time, _last, sample: sample, sides=None):
    """Engage at 0.1 s and send all joints to `position(time)` [m]; return what came of it."""
    rig, bench = sides or on_rig(config)
    last = None
    tension, behind, advice, states, tip = [], [], [], [], []
    for k in range(round(seconds / DT)):
        time = k * DT
        samples = []
        for sample in rig.read(time):
            last = spoiled(time, last, sample)
            samples.append(last)
        engaged = time > 0.1
        asked = (position(time - 0.1) if engaged else 0.0,) * len(rig.joints)
        ahead = (position(time - 0.1 + DT) if engaged else 0.0,) * len(rig.joints)
        speed = tuple((b - a) / DT for a, b in zip(asked, ahead, strict=True))
        nothing = (0.0,) * (MAX_JOINTS - len(rig.joints))
        state = State.ENGAGED if engaged else State.READY
        command = Command(state=state, position=asked + nothing, velocity=speed + nothing)
        advice.append(Advice(bench.memory.advice))
        output = bench.tick(samples, command)
        if output.motor:
            rig.write(np.array(output.motor))
        states.append(output.state)
        tip.append(bench.memory.coupling.tip[0])
        tension.append(rig._truth[0].copy())
        behind.append(np.array(output.motor or (0.0,) * rig.tendons) - last.proximal_displacement)
        if bench.state is State.FAULT:
            break
    return Run(bench, time, np.array(tension), np.array(behind), advice, states, np.array(tip))


def on_rig(config):
    """Return a simulated rig and the slave that a config makes of it."""
    rig = SimulatedRig(config.rig)
    model = loop.build_rig_model(
        rig.joints, [t.build_model() for t in load_tendon_configs(config, rig.tendons)]
    )
    return rig, SlaveBench(model, config, rig.starts_at_zero)


def wall(tendons=2, **settings):
    return build_joint(0.8, environment=WallConfig(position=0.002), tendons=tendons, **settings)


def slave(*joints, effects=(), **settings):
    """Return the config of a slave on a simulated rig, with the plant's own model of it."""
    rig = SimulatedRigConfig(joints=joints, effects=effects)
    settings = {"calibration": "as-built", "gate": GATE} | settings
    return SlaveConfig(rig=rig, **settings)


def to(place, speed):
    return lambda time: min(speed * time, place)


def frozen(start, *what):
    """Return a driver that gives the same frame from `start` [s] on, or the same values of it."""

    def spoiled(time, last, sample):
        if time < start:
            return sample
        fields = what or ("proximal_tension", "proximal_displacement")
        return replace(sample, **{name: getattr(last, name) for name in fields})

    return spoiled


@pytest.mark.parametrize(
    ("tendons", "start", "speed"),
    [
        *((1, 0.3, 0.02), (2, 0.5, 0.2), (2, 0.15, 0.005)),
        *(
            pytest.param(tendons, start, speed, marks=pytest.mark.slow)
            for tendons in (1, 2)
            for start, speed in ((0.15, 0.2), (0.3, 0.005), (0.5, 0.02))
        ),
    ],
)
def test_a_frame_that_is_given_again_and_again_pulls_no_tendon_over_the_gates_limit(
    tendons, start, speed
):
    """A wall at 2 mm, and the command goes to 20 mm: without the frames' age 44 and 76 N."""
    config = slave(wall(tendons, pretension=2.0, spring=300.0 if tendons == 1 else 0.0))
    session = run(config, to(0.020, speed), 4.0, frozen(start))
    assert session.tension.max() < config.gate.tension_max


def test_frames_that_stay_the_same_are_a_fault_by_name_and_an_older_command_is_none():
    session = run(slave(wall()), to(0.020, 0.02), 1.0, frozen(0.15))
    assert session.bench.session.reason is Reason.SAMPLES_FROZEN
    still = run(slave(wall()), to(0.0, 0.02), 1.0, frozen(0.15))
    assert still.bench.state is State.ENGAGED


def test_a_motor_that_does_not_go_where_it_is_sent_is_a_fault_that_names_it():
    only_b = frozen(0.3, "proximal_displacement")

    def spoiled(time, last, sample):
        place = np.array(sample.proximal_displacement)
        place[1] = only_b(time, last, sample).proximal_displacement[1]
        return replace(sample, proximal_displacement=place)

    free = slave(build_joint(0.8, environment=FreeConfig()))
    session = run(free, to(0.020, 0.02), 2.0, spoiled)
    assert session.bench.session.reason is Reason.MOTOR_POSITION_ERROR
    assert session.bench.memory.faulty_tendon == 1
    lag = free.fault_detection.motor_lag
    assert lag < np.abs(session.behind[-1, 1]) < lag + 0.002


def configured(name):
    return load(CONFIGS / f"{name}.yaml", SlaveConfig, "slave")


def dashes(reach):
    """Go to and fro as fast as the slave lets a motor go."""
    return lambda time: reach * (1.0 if time % 1.2 < 0.6 else -0.5)


@pytest.mark.parametrize(
    "name",
    [
        "bowden",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("demo", "paper-joint", "arm")),
    ],
)
def test_motors_at_their_limits_stay_well_within_what_they_may_be_behind(name):
    config = configured(name)
    session = run(config, dashes(0.02), 2.5)
    assert session.bench.state is State.ENGAGED
    assert np.abs(session.behind).max() < 0.4 * config.fault_detection.motor_lag
    assert np.abs(np.diff(session.behind, axis=0)).max() > 0.0


def test_played_data_need_not_go_where_the_motors_are_sent(tmp_path):
    config = SlaveConfig(rig=ReplayedRigConfig(file=tmp_path / "data.csv"))
    assert not config.is_actuated
    assert slave(wall()).is_actuated


def pressing(time, reach=0.008, leg=1.0, rest=0.1):
    """Press and let go, smoothly, with a rest at both ends."""
    place = time % (2.0 * (leg + rest))
    share = min((place % (leg + rest)) / leg, 1.0)
    way = reach * (share - math.sin(2.0 * math.pi * share) / (2.0 * math.pi))
    return way if place < leg + rest else reach - way


def test_a_sheath_that_changes_its_shape_is_advised_of_and_then_a_fault():
    """T_out is wrong by e^(K change) - 1: 10 % at first, 30 % in the end."""
    tissue = TissueConfig(position=0.002, stiffness=20_000.0)
    steps = tuple(
        FrictionStep(change=change, start=start, tendon="a")
        for change, start in ((0.12, 0.5), (0.2, 5.5))
    )
    config = slave(build_joint(0.8, environment=tissue, noise=0.01), effects=steps)
    session = run(config, lambda time: pressing(time, leg=0.9), 15.0)
    first = {said: session.advice.index(said) * DT for said in session.advice}
    assert 0.5 < first[Advice.ADVISED] < 5.5 < first[Advice.DEMANDED]
    assert session.advice.count(Advice.DEMANDED) == 1  # it was engaged until then
    assert session.bench.session.reason is Reason.CALIBRATION_DUE


@pytest.mark.slow
def test_a_joint_that_swings_in_from_a_stop_by_itself_is_no_change_of_shape():
    """Both tendons relax then, while the motor still goes on: for a while T_out is 20 % lower."""
    places = (0.006, 0.011, 0.0035, 0.01225, 0.001)  # [m] reached for, the stop is at 8 mm

    def reaches(time):
        k, share = int(time / 1.1), min(time % 1.1 / 0.8, 1.0)
        here, there = places[k % 5], places[(k + 1) % 5]
        smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share * share)
        return here + (there - here) * smooth - 0.006 * max(1.0 - 2.0 * time, 0.0)

    session = run(configured("paper-joint"), reaches, 14.0)
    assert set(session.advice) == {Advice.NONE}
    assert session.bench.memory.monitors[0].count > 2


def by_hand(**settings):
    """Return the config of a slave whose model was written down without a load cell's noise."""
    model = TendonConfig(effective_friction=0.8, pretension=0.5)
    return slave(wall(settings.pop("tendons")), tendons=(model,), calibration=None, **settings)


@pytest.mark.parametrize(("tendons", "start"), [(1, 0.4), (2, 0.0), (2, 0.15)])
def test_a_stuck_cell_is_found_where_the_model_was_written_without_its_noise(tendons, start):
    effects = (StuckCell(start=start, tendon="a"),)
    session = run(by_hand(tendons=tendons, effects=effects), to(0.020, 0.02), 3.0)
    reasons = {Reason.CELL_STUCK, Reason.CELL_SATURATED}
    assert session.bench.session.reason in reasons
    assert session.bench.memory.faulty_tendon == 0
    assert session.tension.max() < GATE.tension_max


def test_what_was_found_lasts_from_one_sample_to_the_next():
    """The fault is not over because a tick brings no sample."""
    config = by_hand(tendons=1, effects=(StuckCell(start=0.15),))
    bench = run(config, to(0.020, 0.02), 1.0).bench
    for _ in range(20):
        bench.tick([], Command(state=State.READY))
        assert bench.state is State.FAULT
        assert bench.session.reason in (Reason.CELL_STUCK, Reason.CELL_SATURATED)
