import dataclasses
import math

import numpy as np
import pytest

from slave.config import SlaveConfig
from slave.rig import RigFault, RigFinished
from slave.rigs import open_rig
from slave.rigs.replayed_data import ReplayedRigConfig
from slave.rigs.simulated import (
    CATCH_UP_STEPS_MAX,
    JointConfig,
    SimulatedRig,
    SimulatedRigConfig,
    TendonPlantConfig,
    build_joint,
)
from slave.simulation.environment import WallConfig
from slave.simulation.joint import BodyConfig, Joint
from slave.simulation.sensor_models import EncoderConfig, LoadCellConfig
from teleop.config.loading import load
from teleop.data.measured_table import Columns, read_table, write_table
from teleop.errors import UsageError

TENDON = TendonPlantConfig(load_cell=LoadCellConfig(0.0, 0.0), encoder=EncoderConfig(0))
QUIET = JointConfig((TENDON,))
PAIR = JointConfig((TENDON, TENDON))


def played(rig, targets, start=0):
    """Read once a millisecond, then write; return the samples."""
    samples = []
    for k, target in enumerate(targets, start):
        samples.extend(rig.read(k * 1e-3))
        rig.write(np.full(rig.tendons, target))
    return samples


# --- simulated


def test_a_plant_computed_ahead_gives_the_same_samples():
    config = SimulatedRigConfig(joints=(PAIR, QUIET))
    plain, ahead = SimulatedRig(config), SimulatedRig(config)
    ahead.advance()
    for k in range(200):
        target = np.array([k * 1e-5, -k * 1e-5, 2e-5 * k])
        (expected,), (sample,) = plain.read(k * 1e-3), ahead.read(k * 1e-3)
        assert sample.time_s == expected.time_s
        assert (sample.proximal_tension == expected.proximal_tension).all()
        assert (sample.bench_distal_displacement == expected.bench_distal_displacement).all()
        for rig in (plain, ahead):
            rig.write(target)
        ahead.advance()
        ahead.advance()  # at most one step ahead
    assert ahead.read(0.19) == ()  # nothing before its time


def test_tendons_are_numbered_joint_after_joint():
    rig = SimulatedRig(SimulatedRigConfig(name="arm", joints=(PAIR, QUIET, PAIR)))
    assert rig.name == "arm"
    assert rig.joints == ((0, 1), (2,), (3, 4))
    assert rig.tendons == 5
    for k in range(100):
        (sample,) = rig.read(k * 1e-3)
        rig.write(np.array([2e-3, -2e-3, 0.0, 0.0, 0.0]))
    travel = sample.bench_distal_displacement
    assert travel[0] == -travel[1]
    assert travel[0] > 1e-4
    assert travel[2:] == pytest.approx(0.0, abs=1e-9)
    assert sample.proximal_displacement[:2] == pytest.approx([2e-3, -2e-3], abs=1e-6)


def test_samples_come_on_the_plants_grid_once_each():
    rig = SimulatedRig(SimulatedRigConfig())
    times = [rig.read(time) for time in (0.0, 0.0004, 0.0011, 0.0012, 0.0042)]
    assert [[s.time_s for s in samples] for samples in times] == [[0.0], [], [0.001], [], [0.004]]


def test_the_same_seed_gives_the_same_samples_and_another_does_not():
    targets = np.linspace(0.0, 5e-3, 200)

    def tensions(seed):
        rig = SimulatedRig(SimulatedRigConfig(seed=seed))
        return [s.proximal_tension[0] for s in played(rig, targets)]

    assert tensions(3) == tensions(3)
    assert tensions(3) != tensions(4)


def test_a_late_read_catches_up_in_few_steps_and_says_so():
    rig = SimulatedRig(SimulatedRigConfig(joints=(QUIET,)))
    rig.read(0.0)
    rig.write(np.array([4e-3]))
    rig.read(CATCH_UP_STEPS_MAX * 1e-3)
    assert rig.coarse_reads == 0
    (sample,) = rig.read(2.0)
    assert rig.coarse_reads == 1
    assert sample.time_s == pytest.approx(2.0)
    assert sample.proximal_displacement[0] == pytest.approx(4e-3, abs=1e-6)


@pytest.mark.parametrize("targets", [[math.nan], [math.inf], [0.0, 0.0], []])
def test_a_motor_position_that_is_none_is_a_fault_and_moves_nothing(targets):
    rig = SimulatedRig(SimulatedRigConfig(joints=(QUIET,)))
    rig.read(0.0)
    with pytest.raises(RigFault):
        rig.write(np.array(targets))
    (sample,) = rig.read(0.1)
    assert sample.proximal_displacement[0] == pytest.approx(0.0, abs=1e-9)


def test_the_state_stays_finite_whatever_the_motors_are_sent():
    rng = np.random.default_rng(0)
    wall = WallConfig(position=0.002, stiffness=1e6, damping=50.0)
    body = BodyConfig(mass=0.0, damping=0.0, friction=1.0, spring=0.0, pretension=0.0)
    rig = SimulatedRig(SimulatedRigConfig(joints=(JointConfig((TENDON,) * 2, body, wall), QUIET)))
    for k in range(2000):
        (sample,) = rig.read(k * 1e-3)
        if k % 7 == 0:
            rig.write(rng.uniform(-1.0, 1.0, 3) * 10.0 ** rng.uniform(-4, 2, 3))
        for values in (sample.proximal_tension, sample.bench_distal_tension):
            assert np.all(np.isfinite(values))
            assert values.min() >= 0.0 or values is sample.proximal_tension
        assert np.all(np.abs(sample.bench_distal_displacement) <= 0.030)


def test_a_config_file_makes_the_rig(tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text(
        "slave:\n"
        "  type: simulated\n"
        "  name: bench\n"
        "  joints:\n"
        "    - tendons:\n"
        "        - sheath: {sections: [{length: 0.5}, {length: 1, radius: 0.2}], friction: 0.1}\n"
        "        - {motor: {pulley_radius: 0.005}, encoder: {decoding: 4}}\n"
        "      body: {mass: 0.1, stops: [-0.01, 0.02]}\n"
        "      environment: {type: several, parts: [{type: wall}, {type: tissue, side: b}]}\n"
        "    - environment: {type: load_motor, mode: position, profile: [[0, 0], [1, 0.002]]}\n"
        "  effects: [{type: joint_friction, joint: 2, start: 3}]\n"
    )
    config = load(file, SimulatedRigConfig, "slave")
    joint = build_joint(config.joints[0])
    assert isinstance(joint, Joint)
    assert joint.pair
    assert joint.a.chain.friction.sum() == pytest.approx(0.1 * 1.0 / 0.2)
    assert joint.b.motor.mass == pytest.approx(4.0 * joint.a.motor.mass)
    assert len(joint.environment.kind) == 2
    assert open_rig(config).joints == ((0, 1), (2,))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("joints: [{tendons: [{sheath: {nodes: 0}}]}]", r"joints\.0\.tendons\.0\.sheath\.nodes"),
        ("joints: [{tendons: [{}, {}, {}]}]", r"joints\.0\.tendons: must be 1 or 2"),
        ("joints: [{environment: {type: wal}}]", r"environment\.type: .*did you mean 'wall'"),
        ("name: ' '", r"name: .*must not be empty"),
        ("joints: [{tendons: [{motor: {gear: 5}}]}]", r"period: 0.001: .* rotor .* joint 1"),
    ],
)
def test_a_rig_that_cannot_be_is_named_where_it_stands(text, message, tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text(f"slave: {{{text}}}\n")
    with pytest.raises(UsageError, match=message):
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
        "proximal_displacement_m": rng.uniform(0, 0.0005, ROWS),
        "distal_tension_N": rng.uniform(0, 10, ROWS),
        "proximal_tension_2_N": rng.uniform(0, 20, ROWS),
    }
    write_table(path, columns)
    return path


@pytest.mark.parametrize("period", [0.0003, 0.05])
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


def test_a_loop_goes_on_for_ever_with_time_that_increases(measured):
    table = read_table(measured)
    rig = open_rig(ReplayedRigConfig(file=measured, loop=True))
    samples = [s for k in range(2000) for s in rig.read(k * 1e-3)]
    assert len(samples) > 2 * ROWS
    assert np.all(np.diff([s.time_s for s in samples]) > 0)
    second = [float(s.proximal_tension[0]) for s in samples[ROWS : 2 * ROWS]]
    assert second == table.proximal_tension.tolist()


def test_several_tendons_of_one_file(measured):
    both = (Columns(), Columns.from_tendon(2))
    rig = open_rig(ReplayedRigConfig(file=measured, tendons=both))
    (sample,) = rig.read(0.0)
    assert rig.tendons == 2
    assert rig.joints == ((0,), (1,))
    assert rig.name == "measured.csv"
    assert open_rig(ReplayedRigConfig(file=measured, name="bench 3")).name == "bench 3"
    assert sample.proximal_tension[1] == read_table(measured, both[1]).proximal_tension[0]
    assert np.isfinite(sample.proximal_displacement[0])
    assert np.isnan(sample.proximal_displacement[1])  # the second has no encoder


def test_a_mapping_beside_the_config_tells_columns_units_and_the_run(tmp_path):
    rows = [f"{20 * k},{1 + k / 9:.3f},{k},{k + 1:.2f}" for k in range(30)]
    (tmp_path / "pull.csv").write_text("\n".join(["t,cell,q_mm,other", *rows, *reversed(rows)]))
    (tmp_path / "lab.yaml").write_text(
        "columns: {time: {column: t, unit: ms}, proximal_tension: {column: cell, unit: N, "
        "scale: 2}, proximal_displacement: {column: q_mm}}\n"
    )
    config = tmp_path / "rig.yaml"
    rig = "{type: replayed, file: pull.csv, mapping: lab.yaml, run: 2}"
    config.write_text(f"slave: {{rig: {rig}}}\n")
    with pytest.raises(UsageError, match=r"--run 2: the file has 1 run$"):
        open_rig(load(config, SlaveConfig, "slave").rig)
    (tmp_path / "pull.csv").write_text("\n".join(["t,cell,q_mm,other", *rows, *rows[:25]]))
    read = open_rig(load(config, SlaveConfig, "slave").rig).read(10.0)
    assert len(read) == 25
    assert [read[9].time_s, read[9].proximal_tension[0]] == pytest.approx([0.18, 4.0])
    assert read[9].proximal_displacement[0] == pytest.approx(9e-3)
    played = open_rig(load(config, SlaveConfig, "slave").rig)
    assert "time from t [ms]; proximal_tension from cell [2 N]" in played.summarise()["read_as"]
    with pytest.raises(UsageError, match=r"has 2 runs.*slave\.rig\.run"):
        open_rig(ReplayedRigConfig(file=tmp_path / "pull.csv", mapping=tmp_path / "lab.yaml"))
    both = (Columns(proximal_displacement=None), Columns(proximal_tension="other"))
    played = ReplayedRigConfig(file=tmp_path / "pull.csv", mapping=tmp_path / "lab.yaml", run=1)
    sample = open_rig(dataclasses.replace(played, tendons=both)).read(0.0)[0]
    assert sample.proximal_tension.tolist() == [2.0, 1.0]
    assert sample.proximal_displacement is None


def test_measured_data_without_travel_can_be_played_and_tells_how_far(tmp_path):
    path = tmp_path / "tension_only.csv"
    write_table(path, {"time_s": np.arange(5) * 0.01, "proximal_tension_N": np.full(5, 2.0)})
    rig = open_rig(ReplayedRigConfig(file=path))
    (first, second) = rig.read(0.015)
    assert first.proximal_displacement is second.proximal_displacement is None
    assert rig.starts_at_zero
    read_as = "5 samples, 0.04 s, 100 Hz"
    assert rig.summarise() == {"rows": 5, "played": 2, "spikes": 0, "read_as": read_as}
