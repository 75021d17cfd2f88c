"""`--model`: what a diagnosis found in the commands that estimate forces; wrong words and files."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from estimator.effects import CATALOGUE, NAMES
from estimator.online.extended_model import build_extended_model
from slave import model_files
from slave.config import SlaveConfig, load_tendon_configs
from slave.tendon_config import TendonConfig
from studies import hidden_effects
from teleop.cli import commands
from teleop.config.loading import load
from teleop.data.measured_table import read_table, write_table
from teleop.errors import UsageError

JOINTS = ((0, 1), (2, 3))
PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "diagnose.md"


def write(path, *effects, K=0.8):
    rows = [{"name": name, "where": where, "parameters": values} for name, where, values in effects]
    base = {"K": K, "compliance": 1e-4, "tip_compliance": 2e-4}
    path.write_text(yaml.safe_dump({"base": base, "duration": 60.0, "effects": rows}))
    return path


CREEP = ("creep", "", {"share": 0.1, "time": 8.0})
DRAG = ("constant_drag", "", {"drag": 0.4})
MOVED = ("tip_moved", "and left it there", {"size": 1e-4, "onset": 3.0, "duration": 0.5})


@pytest.fixture
def file(tmp_path):
    return write(tmp_path / "model.yaml", CREEP, DRAG, MOVED)


@pytest.fixture(scope="module")
def data():
    return hidden_effects.make(1, "tension_dependent_friction", duration=20.0, rate=50.0)


@pytest.fixture(scope="module")
def csv(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "bench.csv"
    units = {"tension": "N", "displacement": "m"}
    columns = {f"{n}_{units[n.split('_')[1]]}": y for n, y in data.channels.items()}
    write_table(path, {"time_s": data.time} | columns)
    return path


@pytest.fixture
def true_model(data, tmp_path):
    sheath = data.truth["sheath"]
    exponent = data.truth["tension_dependent_friction"]["exponent"]
    tree = {
        "base": {"K": sheath["K"], "compliance": sheath["L"] / sheath["EA"], "tip_compliance": 0.0},
        "duration": 20.0,
        "effects": [
            {
                "name": "tension_dependent_friction",
                "where": "a power of the tension",
                "parameters": {"exponent": exponent},
            }
        ],
    }
    path = tmp_path / "true.yaml"
    path.write_text(yaml.safe_dump(tree))
    return path


def summary_of(tmp_path, *words):
    out = tmp_path / "summary.json"
    assert commands.main(["estimate", *map(str, words), "--json", str(out), "--force"]) == 0
    return json.loads(out.read_text())


def one_line(capsys, *words):
    assert commands.main([*map(str, words)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_an_estimate_with_the_model_is_better_than_with_its_law_alone(csv, true_model, tmp_path):
    found = summary_of(tmp_path, csv, "--model", true_model)
    tree = yaml.safe_load(true_model.read_text())
    tree["effects"] = []
    law = tmp_path / "law.yaml"
    law.write_text(yaml.safe_dump(tree))
    plain = summary_of(tmp_path, csv, "--model", law)
    assert found["force_error"]["rmse_N"] < 0.4 * plain["force_error"]["rmse_N"]
    assert found["effects"] == [
        "tension_dependent_friction (a power of the tension) is run beside the law"
    ]
    assert plain["effects"] == ["sheath model without effects"]


def test_an_estimate_is_compared_with_what_a_wrong_cell_at_the_tip_reads(csv, tmp_path):
    table = read_table(csv)
    spoilt = tmp_path / "spoilt.csv"
    write_table(spoilt, table.columns() | {"distal_tension_N": 1.2 * table.distal_tension})
    gain = write(tmp_path / "gain.yaml", ("distal_tension_gain", "", {"gain": 0.2}))
    none = write(tmp_path / "none.yaml")
    one = summary_of(tmp_path, spoilt, "--model", gain, "--out", tmp_path / "a.csv")
    other = summary_of(tmp_path, csv, "--model", none, "--out", tmp_path / "b.csv")
    assert one["force_error"]["rmse_N"] == pytest.approx(1.2 * other["force_error"]["rmse_N"])
    assert "in what the sensor at the tip reads" in one["effects"][0]
    forces = [
        read_table(tmp_path / name).extra["distal_tension_estimate_N"]
        for name in ("a.csv", "b.csv")
    ]
    assert np.array_equal(*forces)


def test_a_model_file_says_all_of_the_sheath(file):
    with pytest.raises(ValueError, match=r"^drag: conflicts with model_file"):
        TendonConfig(model_file=file, drag=0.1)
    with pytest.raises(ValueError, match=r"^effective_friction: conflicts"):
        TendonConfig(model_file=file, effective_friction=0.5)
    model = TendonConfig(model_file=file, length=2.0).build_model()
    sheath = model.sheath
    numbers = sheath.K, sheath.axial_stiffness, sheath.drag
    assert numbers == pytest.approx((0.8, 2.0 / 1e-4, 0.4))
    assert model.extension is not None


def test_a_config_names_its_model_from_its_own_folder(file, tmp_path):
    config = tmp_path / "rig.yaml"
    config.write_text("slave: {tendons: [{model_file: model.yaml}]}\n")
    (tendon,) = load(config, SlaveConfig, "slave").tendons
    assert tendon.model_file == file
    numbers = tendon.build_model().sheath.K, tendon.build_model().sheath.length
    assert numbers == pytest.approx((0.8, 1.5))
    config.write_text("slave: {tendons: [{model_file: none.yaml}]}\n")
    with pytest.raises(UsageError, match=r"none\.yaml: cannot read"):
        load(config, SlaveConfig, "slave")


def test_noise_and_pretension_stay_where_a_model_replaces_the_sheath(file):
    known = TendonConfig(
        effective_friction=0.5, tension_noise=0.01, pretension=0.7, drag=0.2, loop_friction=0.3
    )
    (tendon,) = load_tendon_configs(SlaveConfig(tendons=(known,)), 1, ((0,),), {"": file})
    assert (tendon.tension_noise, tendon.pretension, tendon.loop_friction) == (0.01, 0.7, 0.3)
    assert tendon.build_model().sheath.drag == pytest.approx(0.4)
    (alone,) = load_tendon_configs(SlaveConfig(), 1, ((0,),), {"": file})
    assert alone.model_file == file


def test_one_tendon_of_several_gets_its_own(file, tmp_path):
    other = write(tmp_path / "other.yaml", K=0.5)
    known = SlaveConfig(tendons=(TendonConfig(effective_friction=1.0),))
    given = model_files.parse([f"2a={file}", f"4={other}"])
    found = load_tendon_configs(known, 4, JOINTS, given)
    assert [one.build_model().sheath.K for one in found] == pytest.approx([1.0, 1.0, 0.8, 0.5])
    with pytest.raises(UsageError, match="must be one of 1a, 1b, 2a, 2b, 1, 2, 3, 4"):
        load_tendon_configs(known, 4, JOINTS, {"3a": file})
    with pytest.raises(UsageError, match="missing for some tendons"):
        load_tendon_configs(SlaveConfig(), 4, JOINTS, {"2a": file})


def test_the_slave_says_what_it_does_with_each_effect(file):
    said = model_files.describe_models([TendonConfig(model_file=file, tension_noise=0.01)] * 2)
    assert [line.removeprefix(f"{file}: ") for line in said] == [
        "creep is run beside the law",
        "constant_drag is in the friction and shape of the sheath",
        "tip_moved (and left it there) is left out: it belongs to the record it was found in",
    ]
    assert model_files.describe_models([TendonConfig(effective_friction=0.5)]) == []
    assert model_files.describe_models([TendonConfig(model_file=file)])[-1].startswith("WARNING")


def test_a_model_of_another_sheath_is_a_warning(file):
    used = [TendonConfig(model_file=file)]
    near, far = ([TendonConfig(effective_friction=K)] for K in (0.7, 1.5))
    assert (
        model_files.find_friction_warnings(near, used)
        == model_files.find_friction_warnings(used, used)
        == []
    )
    (line,) = model_files.find_friction_warnings(far * 2, used * 2)
    assert re.search(r"WARNING: .*model\.yaml: its K is 0\.8\d*, the calibrated K is 1\.5", line)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--fit", "--model", "x.yaml"], "conflicts with --fit"),
        (
            ["--model", "x.yaml", "--calibration", "y.yaml", "--config", "z.yaml"],
            "no model of the sheath",
        ),
        (["--model", "x.yaml"], "x.yaml: cannot read"),
        (["--model", "x.yaml", "--model", "y.yaml"], "there is already a model for every tendon"),
        (["--model", "2a=x.yaml"], "must be one of"),
        (["--model", ""], "missing"),
    ],
)
def test_wrong_words_are_one_line(csv, words, said, capsys):
    assert said in one_line(capsys, "estimate", csv, *words)


def test_a_model_and_a_calibration_at_the_start_contradict_each_other(file, capsys):
    words = ["--set", "slave.initialise.at_start=true", "--set", "slave.calibration=as-built"]
    assert "use one of them" in one_line(capsys, "slave", "--model", file, *words)


def test_the_page_says_what_becomes_of_each_effect():
    _, _, section = PAGE.read_text().partition("## In the hand")
    rows = re.findall(r"^\| (\w.*?) \| (`.*) \|$", section.partition("RMSE of")[0], re.M)
    said = {(name, use) for use, names in rows for name in re.findall(r"`(\w+)`", names)}
    assert {name for name, _ in said} >= set(NAMES)
    for effect in CATALOGUE:
        values = tuple(10.0 if p.jumps else (2.0 * p.low + p.high) / 3.0 for p in effect.parameters)
        ((_, _, use),) = build_extended_model((0.4, 1e-4, 1e-4), [(effect, values)], 60.0, 1.5).uses
        assert any(text.startswith(use.value) for name, text in said if name == effect.name)
