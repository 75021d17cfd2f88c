"""`teleop estimate --adapt` on the chain of the estimator's test, and on the study's pair."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from slave.rigs.replayed_data import ReplayedRig, ReplayedRigConfig
from slave.rigs.virtual_bench import load_rig_config, simulate
from studies.adaptation import RATE, simulate_use
from teleop.cli import commands
from teleop.data.measured_table import write_table
from tests.estimator.test_adaptation import simulate as simulate_chain

MODEL = "slave.tendons=[{effective_friction: 1.0, tension_noise: 0.02, displacement_noise: 1.0e-6}]"


def test_what_became_of_k_is_reported_with_the_gain(tmp_path, capsys):
    time, T, q, T_out = simulate_chain(1.4)
    names = "time_s", "proximal_tension_N", "proximal_displacement_m", "distal_tension_N"
    path, out = tmp_path / "use.csv", tmp_path / "summary.json"
    write_table(path, dict(zip(names, (time, T, q, T_out), strict=True)))
    words = ["estimate", str(path), "--set", MODEL, "--adapt", "--json", str(out)]
    assert commands.main(words) == 0
    summary = json.loads(out.read_text())
    assert summary["adaptation"]["K"] == pytest.approx(1.4, rel=0.06)
    fixed = summary["adaptation"]["fixed_K_error"]["rmse_N"]
    assert summary["force_error"]["rmse_N"] < 0.8 * fixed
    assert "the shape changed before" in capsys.readouterr().out


def write_use(folder, use):
    """Write the config and the data of a joint in use; return the words that adapt to them."""
    tendons = [
        {"sheath": {"sections": [{"length": s.length, "radius": s.radius} for s in sheath.sections],
                    "friction": sheath.friction, "axial_stiffness": sheath.axial_stiffness}}
        for sheath in (model.sheath for model in use.models)
    ]  # fmt: skip
    rig = {"type": "simulated", "joints": [{"tendons": tendons}]}
    config, data, out = (folder / name for name in ("pair.yaml", "use.csv", "out.json"))
    config.write_text(yaml.safe_dump({"slave": {"calibration": "as-built", "rig": rig}}))
    rows = {"time_s": use.time}
    for k in range(len(tendons)):
        suffix = f"_{k + 1}" if k else ""
        rows[f"proximal_tension{suffix}_N"] = use.tension[:, k]
        rows[f"proximal_displacement{suffix}_m"] = use.travel[:, k]
        rows[f"distal_tension{suffix}_N"] = use.tip[:, k]
    write_table(data, rows)
    return ["estimate", str(data), "--config", str(config), "--adapt", "--json", str(out)]


@pytest.mark.parametrize("is_moved", [False, True])
def test_only_a_tip_that_something_else_moves_leaves_adaptation_undecided(
    tmp_path, capsys, is_moved
):
    use = simulate_use(24, pair=False)  # its tip follows far, most of the time
    if is_moved:
        noise = np.random.default_rng(1).normal(0.0, 1e-3, use.travel.shape)
        use.travel[:] += np.cumsum(noise, axis=0) / np.sqrt(RATE)
    words = write_use(tmp_path, use)
    assert commands.main(words) == 0
    assert ("adaptation cannot decide" in capsys.readouterr().out) is is_moved


def test_a_sensing_loop_in_the_data_is_used(tmp_path, refused):
    rig = {"type": "simulated", "effects": [{"type": "friction_step", "start": 8.0, "change": 0.3}],
           "joints": [{"tendons": [{"loop": {}, "sheath": {"nodes": 20}}]}]}  # fmt: skip
    config, data, out = (tmp_path / name for name in ("rig.yaml", "use.csv", "out.json"))
    config.write_text(yaml.safe_dump({"slave": {"calibration": "as-built", "rig": rig}}))
    run = simulate(load_rig_config(config), profile="sine", duration=12.0, rate=200.0)
    run.save(data)
    words = ["estimate", str(data), "--config", str(config), "--adapt", "--json", str(out)]
    assert commands.main(words) == 0
    adaptation = json.loads(out.read_text())["adaptation"]
    assert adaptation["K"] == pytest.approx(1.3, rel=0.02)
    assert 8.0 < adaptation["changed_at_s"] < 10.0
    sample = ReplayedRig(ReplayedRigConfig(file=data)).read(0.0)[0]
    assert sample.loop_moved_tension == pytest.approx(run.loop_tension[0, 0], rel=1e-6)
    lines = data.read_text().replace("loop_held_tension_N", "other").splitlines()
    data.write_text("\n".join(lines))
    assert "column 'loop_held_tension_N': a sensing loop needs" in refused(*words[:-2])


def test_adaptation_needs_a_travel_and_a_model_from_before(tmp_path, refused):
    time, T, *_ = simulate_chain(1.0)
    path = tmp_path / "tension.csv"
    write_table(path, {"time_s": time, "proximal_tension_N": T})
    said = refused("estimate", path, "--set", MODEL, "--adapt")
    assert "--adapt: needs proximal_displacement_m" in said
    assert "--adapt: conflicts with --fit" in refused("estimate", path, "--fit", "--adapt")


def test_both_tendons_of_a_pair_are_adapted_together(tmp_path, refused):
    use = simulate_use(22, pair=True)
    words = write_use(tmp_path, use)
    assert commands.main(words) == 0
    summary = json.loads(Path(words[-1]).read_text())
    assert summary["tendon"] == "1a"
    assert summary["adaptation"]["K"] == pytest.approx(use.K_after[0], rel=0.15)
    fixed = summary["adaptation"]["fixed_K_error"]["rmse_N"]
    assert summary["force_error"]["rmse_N"] < 0.8 * fixed
    words[-2:] = "--column", "proximal_tension=proximal_tension_2_N"
    assert "need their standard names" in refused(*words)
