import numpy as np
import pytest

import teleop
from slave.rigs.simulated import JointConfig, SimulatedRigConfig, TendonPlantConfig
from slave.simulation.environment import WallConfig
from slave.simulation.sensor_models import EncoderConfig, LoadCellConfig
from teleop import MotionScale
from teleop.cli import simulate
from teleop.cli.commands import Parser
from teleop.data.measured_table import read_table
from teleop.errors import UsageError


def run(*words):
    parser = Parser()
    simulate.add_arguments(parser)
    return simulate.main(parser.parse_args([str(word) for word in words]))


def test_it_writes_measured_data_of_the_asked_length(tmp_path, capsys):
    path = tmp_path / "bench.csv"
    assert run("--out", path, "--duration", 2.5, "--rate", 200) == 0
    table = read_table(path)
    assert len(table.time) == 501
    assert np.diff(table.time) == pytest.approx(1 / 200)
    assert table.proximal_displacement is not None
    assert table.distal_tension is not None
    assert table.distal_displacement is not None
    assert np.ptp(table.distal_displacement) > 1e-3
    printed = capsys.readouterr()
    assert "501 rows" in printed.out
    assert "K = 1," in printed.out
    assert printed.err == ""  # no progress bar where nobody looks


def test_the_same_seed_writes_the_same_file_and_another_does_not(tmp_path):
    seeds = {"a": 3, "b": 3, "c": 4}
    for name, seed in seeds.items():
        run("--out", tmp_path / f"{name}.csv", "--duration", 0.5, "--seed", seed)
    one, same, other = ((tmp_path / f"{name}.csv").read_bytes() for name in seeds)
    assert one == same
    assert one != other


def test_the_papers_swing_loses_at_the_tip_what_friction_takes(tmp_path):
    path = tmp_path / "swing.parquet"
    run("--out", path, "--duration", 20)
    table = read_table(path)
    T_in, T_out = table.proximal_tension, table.distal_tension
    assert T_in.max() == pytest.approx(20.0, abs=0.3)
    assert T_out[T_in.argmax()] / T_in.max() == pytest.approx(np.exp(-1.0), rel=0.02)
    turn = T_in.argmax()
    after = slice(turn, turn + 500)  # the tip does not know of the release at once
    assert np.ptp(T_in[after]) > 3.0
    assert np.ptp(T_out[after]) < 0.05


def test_arrays_a_file_and_the_command_have_the_same_samples(tmp_path):
    bench = teleop.make_spring_bench(length=0.8, radius=0.2)
    result = teleop.simulate(bench, "nested", duration=1.0, rate=100.0, seed=5)
    result.save(tmp_path / "bench.csv")
    table, samples = read_table(tmp_path / "bench.csv"), result.tendon()
    for item in ("time", "proximal_tension", "proximal_displacement", "distal_tension"):
        np.testing.assert_allclose(getattr(table, item), getattr(samples, item), atol=1e-9)
    loss = 1.0 - samples.distal_tension[-1] / samples.proximal_tension[-1]
    assert loss == pytest.approx(1.0 - np.exp(-0.2 * 0.8 / 0.2), abs=0.1)  # by the law's friction


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"profile": "zigzag"}, r"profile 'zigzag': allowed are pull-release-pull"),
        ({"rate": 2000.0}, r"rate 2000: .*period"),
        ({"duration": 0.0}, r"duration 0: must be above 0"),
        ({"seed": -1}, r"seed: must be at least 0"),
        ({"config": "none.yaml"}, r"none\.yaml"),
    ],
)
def test_a_call_that_cannot_be_is_one_line(words, message):
    with pytest.raises(UsageError, match=message):
        teleop.simulate(**words)


def test_a_rig_has_the_tendons_that_it_has():
    with pytest.raises(UsageError, match="tendon 2: this rig has 1 to 1"):
        teleop.simulate(duration=0.01).tendon(2)


QUIET = TendonPlantConfig(load_cell=LoadCellConfig(0.0, 0.0), encoder=EncoderConfig(0))


def test_without_noise_the_sensors_tell_what_the_plant_does():
    joint = JointConfig((QUIET,))
    config = SimulatedRigConfig(joints=(joint,) * 2)
    result = teleop.simulate(
        config, "sine", duration=2.0, scale=MotionScale(stroke=0.008, period=2.0)
    )
    assert result.proximal_tension.shape == (2001, 2)
    assert np.array_equal(result.proximal_tension[:, 0], result.proximal_tension[:, 1])
    travel = result.proximal_displacement[:, 0]
    wanted = 0.004 * (1 - np.cos(np.pi * result.time))
    lag = 0.010 * 0.004 * np.pi  # of a position loop of 100 rad/s at the top speed
    assert 0.5 * lag < np.abs(travel - wanted).max() < 1.1 * lag


@pytest.mark.parametrize(("side", "other"), [("a", 1), ("b", 0)])
def test_in_a_pair_one_tendon_makes_the_motion_and_the_other_follows_without_going_slack(
    side, other
):
    wall = WallConfig(position=0.008 if side == "a" else -0.008, side=side)
    config = SimulatedRigConfig(joints=(JointConfig((TendonPlantConfig(),) * 2, environment=wall),))
    run = teleop.simulate(config, duration=8.0, side=side, keep=0.5)
    pulled = run.proximal_tension[:, 1 - other]
    assert pulled.max() == pytest.approx(20.0, abs=0.3)
    assert pulled[pulled.argmax() :].min() == pytest.approx(5.0, abs=0.3)
    loose = run.proximal_tension[1000:, other]
    assert loose.min() > 0.2
    assert loose.max() < 1.0
    travel = run.distal_displacement
    assert np.array_equal(travel[:, 0], -travel[:, 1])
    assert travel[:, 1 - other].max() > 0.008


def test_it_says_which_effects_were_on(tmp_path, capsys):
    config = tmp_path / "faulty.yaml"
    config.write_text(
        "slave: {rig: {type: simulated, effects: [{type: joint_friction, friction: 0.7, start: 2}, "
        "{type: slack, joint: 1, tendon: a}]}}\n"
    )
    path = tmp_path / "faulty.csv"
    run(config, "--out", path, "--duration", 0.1)
    printed = capsys.readouterr().out
    assert "effect joint_friction (friction 0.7), every joint, from 2 s" in printed
    assert "effect slack (length 0.001), joint 1, tendon a, from 0 s" in printed


@pytest.mark.parametrize("name", ["x.txt", "missing/x.csv"])
def test_a_file_that_cannot_be_written_is_refused_before_the_work(tmp_path, name, monkeypatch):
    monkeypatch.setattr(simulate, "simulate", lambda *_, **__: pytest.fail("work was done"))
    with pytest.raises(UsageError):
        run("--out", tmp_path / name)


def test_an_effect_that_the_run_was_too_short_for_is_warned_of(tmp_path, capsys):
    effects = "slave.rig.effects=[{type: slack, start: 100}, {type: joint_friction, start: 0.1}]"
    run("--out", tmp_path / "x.csv", "--duration", 0.2, "--set", effects)
    (warning,) = (line for line in capsys.readouterr().out.splitlines() if "WARNING" in line)
    assert "slave.rig.effects.0: slack starts at 100 s" in warning


@pytest.mark.parametrize(("end", "clipped"), [(8, True), (100, False)])
def test_a_load_cell_that_was_at_its_end_is_warned_of(tmp_path, capsys, end, clipped):
    words = ["--out", tmp_path / "x.csv", "--duration", 4, "--peak", 12]
    cell = f"slave.rig.joints=[{{tendons: [{{load_cell: {{range: {end}}}}}]}}]"
    run(*words, "--set", cell)
    printed = capsys.readouterr().out
    warning = f"readings end at {end} N (load_cell.range), --peak 12 N is never read"
    assert (warning in printed) == clipped
