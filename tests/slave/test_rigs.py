import math
from dataclasses import replace

import numpy as np
import pytest

from slave.plant.joint import Joint
from slave.plant.motor import Motor, MotorConfig, follow
from slave.plant.sensors import EncoderConfig, LoadCellConfig
from slave.rig import RigFault, RigFinished
from slave.rigs import open_rig
from slave.rigs.replayed import ReplayedRigConfig
from slave.rigs.simulated import (
    STEPS_AT_ONCE,
    JointConfig,
    SimulatedRig,
    SimulatedRigConfig,
    build_joint,
)
from slave.table import Columns, read_table, write_table
from teleop.config import load
from teleop.errors import UsageError
from teleop.messages import MAX_JOINTS

QUIET = JointConfig(load_cell=LoadCellConfig(0.0, 0.0), encoder=EncoderConfig(0))


def played(rig, targets, start=0):
    """Read once a millisecond, then write; return the samples."""
    samples = []
    for k, target in enumerate(targets, start):
        samples.extend(rig.read(k * 1e-3))
        rig.write(np.full(rig.tendons, target))
    return samples


# --- simulated


def test_the_default_scene_feels_a_spring_then_tissue():
    rig = SimulatedRig(SimulatedRigConfig(joints=(QUIET,)))
    samples = played(rig, np.linspace(0.0, 14e-3, 2000))
    force = np.array([s.bench_distal_tension[0] for s in samples])
    travel = np.array([s.bench_distal_displacement[0] for s in samples])
    spring, tissue = travel < 8e-3, travel > 8e-3
    assert tissue.sum() > 100
    assert force[spring] == pytest.approx(1.0 + 200.0 * travel[spring], abs=1e-9)
    assert force[tissue] == pytest.approx(2.6 + 1200.0 * (travel[tissue] - 8e-3), abs=1e-8)


def test_samples_come_on_the_plants_grid_once_each():
    rig = SimulatedRig(SimulatedRigConfig())
    times = [rig.read(time) for time in (0.0, 0.0004, 0.0011, 0.0012, 0.0042)]
    assert [[s.time_s for s in samples] for samples in times] == [
        [0.0],
        [],
        [0.001],
        [],
        [0.004],
    ]


def test_the_same_seed_gives_the_same_samples_and_another_does_not():
    targets = np.linspace(0.0, 5e-3, 200)

    def tensions(seed):
        rig = SimulatedRig(SimulatedRigConfig(seed=seed))
        return [s.proximal_tension[0] for s in played(rig, targets)]

    assert tensions(3) == tensions(3)
    assert tensions(3) != tensions(4)


def test_the_load_cell_is_as_noisy_as_it_says_and_the_bench_is_not():
    cell = LoadCellConfig(noise=0.05, resolution=0.002)
    rig = SimulatedRig(SimulatedRigConfig(joints=(replace(QUIET, load_cell=cell),) * 2))
    samples = played(rig, np.zeros(4000))
    readings = np.array([s.proximal_tension for s in samples])
    assert readings.mean(axis=0) == pytest.approx([1.0, 1.0], abs=5 * 0.05 / math.sqrt(4000))
    assert readings.std(axis=0) == pytest.approx([0.05, 0.05], rel=0.06)
    assert abs(np.corrcoef(readings.T)[0, 1]) < 0.08
    ahead = np.corrcoef(readings[1:, 0], readings[:-1, 0])[0, 1]
    assert abs(ahead) < 0.08
    assert np.ptp([s.bench_distal_tension for s in samples]) < 1e-9


def test_readings_are_multiples_of_the_resolution_and_stop_at_the_range():
    cell = LoadCellConfig(noise=0.3, resolution=0.25, range=2.0)
    steps = np.array([cell.read(1.6, normal) for normal in np.linspace(-5, 5, 101)]) / 0.25
    assert np.all(steps == np.round(steps))
    assert steps.max() == 8.0
    assert LoadCellConfig(noise=0.0, resolution=0.0).read(1.2345, 1.0) == 1.2345


def test_the_encoder_counts_lines_of_a_pulley():
    encoder = EncoderConfig(lines=67_000, pulley_radius=0.010)
    line = 2 * math.pi * 0.010 / 67_000
    for travel in np.linspace(-1e-4, 1e-4, 77):
        reading = encoder.read(float(travel))
        assert abs(reading - travel) <= line / 2 * (1 + 1e-9)
        assert reading / line == pytest.approx(round(reading / line), abs=1e-9)
    rig = SimulatedRig(SimulatedRigConfig())
    readings = {s.proximal_displacement[0] for s in played(rig, np.full(20, 1e-4))}
    assert all(r / line == pytest.approx(round(r / line), abs=1e-9) for r in readings)
    assert len(readings) > 10


def test_the_motor_lags_and_keeps_to_its_speed():
    motor = Motor(0.010, 0.050)
    assert follow(motor, 0.0, 1.0, 0.001) == pytest.approx(0.050 * 0.001)
    assert follow(motor, 0.0, -1.0, 0.001) == pytest.approx(-0.050 * 0.001)
    near = follow(motor, 0.0, 1e-5, 0.010)
    assert near == pytest.approx(1e-5 * (1 - math.exp(-1)))
    position = 0.0
    for _ in range(10):  # ten steps of a tenth end where one step does
        position = follow(motor, position, 1e-5, 0.001)
    assert position == pytest.approx(near)
    rig = SimulatedRig(SimulatedRigConfig(joints=(replace(QUIET, motor=MotorConfig(0.01, 0.02)),)))
    travel = np.array([s.proximal_displacement[0] for s in played(rig, np.full(500, 5e-3))])
    assert np.diff(travel).max() == pytest.approx(0.02e-3)
    assert travel[-1] == pytest.approx(5e-3, abs=1e-6)


def test_a_late_read_catches_up_in_few_steps_and_says_so():
    rig = SimulatedRig(SimulatedRigConfig(joints=(QUIET,)))
    rig.read(0.0)
    rig.write(np.array([4e-3]))
    rig.read(STEPS_AT_ONCE * 1e-3)
    assert rig.coarse_reads == 0
    (sample,) = rig.read(2.0)
    assert rig.coarse_reads == 1
    assert sample.time_s == pytest.approx(2.0)
    assert sample.proximal_displacement[0] == pytest.approx(4e-3, abs=1e-9)


@pytest.mark.parametrize("targets", [[math.nan], [math.inf], [0.0, 0.0], []])
def test_a_motor_position_that_is_none_is_a_fault_and_moves_nothing(targets):
    rig = SimulatedRig(SimulatedRigConfig(joints=(QUIET,)))
    rig.read(0.0)
    with pytest.raises(RigFault):
        rig.write(np.array(targets))
    (sample,) = rig.read(0.1)
    assert sample.proximal_displacement[0] == 0.0


def test_joints_are_independent():
    targets = np.linspace(0.0, 10e-3, 300)
    alone = played(SimulatedRig(SimulatedRigConfig(joints=(QUIET,))), targets)[-1]
    stiff = replace(QUIET, tip=replace(QUIET.tip, spring=5000.0))
    both = played(SimulatedRig(SimulatedRigConfig(joints=(stiff, QUIET))), targets)[-1]
    assert both.proximal_tension[1] == alone.proximal_tension[0]
    assert both.proximal_tension[0] > alone.proximal_tension[0]


def test_a_config_file_makes_the_rig(tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text(
        "slave:\n"
        "  type: simulated\n"
        "  joints:\n"
        "    - sheath: {sections: [{length: 0.5}, {length: 1.0, radius: 0.2}], friction: 0.1}\n"
        "      tip: {contacts: []}\n"
        "    - {}\n"
    )
    config = load(file, SimulatedRigConfig, "slave")
    joint = build_joint(config.joints[0])
    assert isinstance(joint, Joint)
    assert joint.chain.friction.sum() == pytest.approx(0.1 * 1.0 / 0.2)
    assert open_rig(config).tendons == 2


def test_a_sheath_too_coarse_is_named_where_it_stands(tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text("slave: {joints: [{sheath: {friction: 2.0, nodes: 5}}]}\n")
    with pytest.raises(UsageError, match=r"slave\.joints\.0\.sheath\.nodes"):
        load(file, SimulatedRigConfig, "slave")


# --- replayed

ROWS = 50


@pytest.fixture
def measured(tmp_path):
    rng = np.random.default_rng(0)
    path = tmp_path / "measured.csv"
    time = 1_700_000_000.0 + np.cumsum(rng.uniform(0.0005, 0.02, ROWS))
    columns = {
        "time_s": time,
        "proximal_tension_N": rng.uniform(0, 20, ROWS),
        "proximal_displacement_m": rng.uniform(0, 0.01, ROWS),
        "distal_tension_N": rng.uniform(0, 10, ROWS),
        "proximal_tension_2_N": rng.uniform(0, 20, ROWS),
    }
    write_table(path, columns)
    return path


@pytest.mark.parametrize("period", [0.0003, 0.001, 0.05, 10.0])
def test_every_row_is_given_once_unchanged_and_in_order(measured, period):
    table = read_table(measured)
    rig = open_rig(ReplayedRigConfig(file=measured))
    samples, tick = [], 0
    while len(samples) < ROWS:
        new = rig.read(tick * period)
        assert all(s.time_s - table.time[0] <= tick * period for s in new)
        samples.extend(new)
        tick += 1
    with pytest.raises(RigFinished):
        rig.read(tick * period)
    assert [s.time_s for s in samples] == table.time.tolist()
    assert [s.proximal_tension.tolist() for s in samples] == table.proximal_tension[
        :, None
    ].tolist()
    travel = [s.proximal_displacement.tolist() for s in samples]
    assert travel == table.proximal_displacement[:, None].tolist()
    bench = [s.bench_distal_tension.tolist() for s in samples]
    assert bench == table.distal_tension[:, None].tolist()
    assert all(s.bench_distal_displacement is None for s in samples)


def test_the_last_row_is_played_before_the_end_is_told(measured):
    rig = open_rig(ReplayedRigConfig(file=measured))
    assert len(rig.read(1e6)) == ROWS
    with pytest.raises(RigFinished):
        rig.read(1e6)


def test_a_row_waits_for_its_time(measured):
    time = read_table(measured).time
    rig = open_rig(ReplayedRigConfig(file=measured))
    assert len(rig.read(0.0)) == 1
    assert rig.read(0.999 * float(time[1] - time[0])) == ()
    rig.write(np.array([math.nan]))  # the motors of measured data are not there
    assert len(rig.read(1.001 * float(time[1] - time[0]))) == 1


def test_a_loop_goes_on_for_ever_with_time_that_increases(measured):
    table = read_table(measured)
    rig = open_rig(ReplayedRigConfig(file=measured, loop=True))
    samples = [s for k in range(2000) for s in rig.read(k * 1e-3)]
    assert len(samples) > 2 * ROWS
    assert np.all(np.diff([s.time_s for s in samples]) > 0)
    second = [float(s.proximal_tension[0]) for s in samples[ROWS : 2 * ROWS]]
    assert second == table.proximal_tension.tolist()


def test_several_tendons_of_one_file(measured):
    both = (Columns(), Columns.of_tendon(2))
    rig = open_rig(ReplayedRigConfig(file=measured, tendons=both))
    (sample,) = rig.read(0.0)
    assert rig.tendons == 2
    assert sample.proximal_tension[1] == read_table(measured, both[1]).proximal_tension[0]
    assert np.isfinite(sample.proximal_displacement[0])
    assert np.isnan(sample.proximal_displacement[1])  # the second has no encoder


def test_a_file_that_cannot_be_right_does_not_become_a_rig(tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text("time_s,proximal_tension_N\n0,1\n0,2\n")
    with pytest.raises(UsageError, match="line 3"):
        open_rig(ReplayedRigConfig(file=path))


def test_a_file_of_more_tendons_than_joints_can_be_is_refused(measured):
    columns = tuple(Columns.of_tendon(k + 1) for k in range(MAX_JOINTS + 1))
    ReplayedRigConfig(file=measured, tendons=columns[:-1])
    with pytest.raises(ValueError, match=f"^tendons: must be 1 to {MAX_JOINTS}"):
        ReplayedRigConfig(file=measured, tendons=columns)


def test_measured_data_without_travel_can_be_played_and_tells_how_far(tmp_path):
    path = tmp_path / "tension_only.csv"
    write_table(path, {"time_s": np.arange(5) * 0.01, "proximal_tension_N": np.full(5, 2.0)})
    rig = open_rig(ReplayedRigConfig(file=path))
    (first, second) = rig.read(0.015)
    assert first.proximal_displacement is second.proximal_displacement is None
    assert rig.starts_at_zero
    assert rig.summary() == {"rows": 5, "played": 2}
