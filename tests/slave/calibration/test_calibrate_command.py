"""`teleop calibrate`, from the command line to the file."""

import re
import signal
from typing import NamedTuple

import numpy as np
import pytest
import yaml

from slave.calibration import calibration_file, command, initialisation, procedure_run
from slave.calibration.analysis import analyse_procedure
from slave.calibration.initialisation import initialise
from slave.config import SlaveConfig, find_not_ready_reason, load_tendon_configs
from slave.rigs import open_rig
from teleop.cli import commands
from teleop.config.loading import as_tree
from teleop.runtime.process import TERMINATION_SIGNALS, interrupt_handler
from tests.slave.calibration.calibration_bench import (
    EA,
    GATE,
    KNOWN,
    LENGTH,
    HousingOnly,
    but,
    joint,
    rig_config,
)

SHORT = joint(body={"stops": (-0.003, 0.003)})


def config_file(folder, rig, **slave):
    tree = {"slave": {"rig": as_tree(rig), "gate": as_tree(GATE), **slave}, "rate_hz": 250}
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(tree))
    return path


def teleop(*words):
    return commands.main(["calibrate", *map(str, words)])


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The command has run on a rig of two joints; the folder it did that in."""
    folder = tmp_path_factory.mktemp("calibrate")
    sheaths = [{"length": LENGTH, "axial_stiffness": EA}]
    rig = rig_config(SHORT, joint(0.6, body={"stops": (-0.003, 0.003)}))
    path = config_file(folder, rig, initialise={"sheaths": sheaths})
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        words = ["--config", path, "--quick", "--together", "--figure", "figure.png"]
        assert teleop(*words) == 0
    return folder


def test_it_writes_a_file_of_its_rigs_name_that_fits_the_rig(done):
    calibration = calibration_file.load(done / "bench-calibration.yaml")
    assert calibration.joints == ((0, 1), (2, 3))
    assert [d.K.value for d in calibration.directions] == pytest.approx([1, 1, 0.6, 0.6], abs=0.02)
    assert calibration.ranges == pytest.approx([0.006, 0.006], rel=0.03)
    assert (done / "figure.png").read_bytes().startswith(b"\x89PNG")
    config = SlaveConfig(rig=rig_config(SHORT, SHORT), calibration=done / "bench-calibration.yaml")
    assert find_not_ready_reason(config, open_rig(config.rig)) == ""
    models = [tendon.build_model().sheath for tendon in load_tendon_configs(config, 4)]
    assert [model.K for model in models] == pytest.approx([1, 1, 0.6, 0.6], abs=0.02)


@pytest.mark.slow
def test_one_joint_alone_renews_its_part_of_the_file(done, capsys):
    before = calibration_file.load(done / "bench-calibration.yaml")
    out = done / "copy.yaml"
    calibration_file.save(out, before)
    words = ["--config", done / "rig.yaml", "--set", "slave.rig.seed=5", "--quick", "--out", out]
    assert teleop(*words, "--joint", 2) == 0
    after = calibration_file.load(out)
    assert after.tendons[:2] == before.tendons[:2]
    assert after.tendons[2:] != before.tendons[2:]
    assert len(after.directions) == 4
    assert "joint 1 as of" in after.method
    printed, print_lines = capsys.readouterr()
    assert "K" in printed
    assert f"{out}: replaces the calibration of {before.time}" in printed
    assert f"teleop run --calibration {out}" in printed
    assert {"tendon a", "tendon b"} == set(re.findall(r"joint 2, (tendon [ab]): ", print_lines))
    assert len(print_lines.splitlines()) < 8


def test_nothing_but_a_calibration_is_written_over(done, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(command, "initialise", lambda *_, **__: pytest.fail("work was done"))
    config, other = config_file(tmp_path, rig_config(SHORT)), tmp_path / "notes.yaml"
    other.write_text("of: mine")
    before = config.read_bytes()
    new, drawn = tmp_path / "new.yaml", tmp_path / "new.png"
    for words, said in [
        (["--out", config, "--force"], "is an input"),
        (["--out", other], "is not a calibration"),
        (["--out", new, "--figure", config], "must end in one of"),
        (["--out", drawn, "--figure", drawn], "is that of --out too"),
        (["--figure", tmp_path / "x.foo"], "must end in one of .png"),
    ]:
        assert teleop("--config", config, *words) == 2
        line = capsys.readouterr().err
        assert said in line
        assert len(line.splitlines()) == 1
    assert (config.read_bytes(), other.read_text()) == (before, "of: mine")
    assert not new.exists()
    assert not drawn.exists()


def test_a_refusal_is_one_line_and_writes_nothing(tmp_path, capsys):
    path = config_file(tmp_path, rig_config(joint(range=12.0)))
    assert teleop("--config", path, "--quick", "--out", tmp_path / "new.yaml") == 1
    *under_way, said = capsys.readouterr().err.splitlines()
    assert said.startswith("teleop: joint 1, tendon a: the load cell reads 12.00 N")
    progress = re.compile(r"calibrating [^:]+: \d+%, joint 1, tendon [ab]: \w")
    assert all(map(progress.match, under_way))
    assert list(tmp_path.iterdir()) == [path]


@pytest.fixture
def handlers_kept(monkeypatch):
    monkeypatch.setattr(interrupt_handler, "number", 0)
    handlers = [signal.getsignal(ending) for ending in TERMINATION_SIGNALS]
    yield
    for ending, handler in zip(TERMINATION_SIGNALS, handlers, strict=True):
        signal.signal(ending, handler)


@pytest.mark.parametrize("number", TERMINATION_SIGNALS)
@pytest.mark.usefixtures("handlers_kept")
def test_a_signal_ends_it_without_a_file(tmp_path, capsys, monkeypatch, number):
    path = config_file(tmp_path, rig_config(SHORT))

    def ticks(rate_hz):
        for tick in procedure_run.generate_fast_ticks(rate_hz):
            if tick.index == 300:
                signal.raise_signal(number)
            yield tick

    monkeypatch.setattr(command, "generate_fast_ticks", ticks)
    assert teleop("--config", path, "--out", tmp_path / "new.yaml") == 128 + number
    assert f"{number.name}: stopped, no file written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("number", "when"), [(signal.SIGTERM, "before"), (signal.SIGINT, "meanwhile")]
)
@pytest.mark.usefixtures("handlers_kept")
def test_a_signal_ends_its_analysis_at_once(tmp_path, capsys, monkeypatch, number, when):
    path = config_file(tmp_path, rig_config(SHORT))

    def signalled(*arguments):
        signal.raise_signal(number)
        return analyse_procedure(*arguments)

    class Driven(NamedTuple):
        record = None

    def last_moment(*_):
        signal.raise_signal(number)
        return Driven()

    monkeypatch.setattr(initialisation, "analyse_procedure", signalled)
    if when == "before":
        monkeypatch.setattr(initialisation, "run_procedure", last_moment)
    words = ["--config", path, "--quick", "--out", tmp_path / "new.yaml"]
    assert teleop(*words) == 128 + number
    assert capsys.readouterr().err.endswith("teleop: interrupted\n")
    assert list(tmp_path.iterdir()) == [path]


def test_measured_data_cannot_be_moved(capsys):
    assert teleop("--set", "slave.rig={type: replayed, file: x.csv}") == 2
    assert "teleop estimate DATA --fit" in capsys.readouterr().err


@pytest.mark.slow
def test_at_the_start_of_a_slave_the_same_is_done_and_the_samples_are_handed_over():
    rig = HousingOnly(rig_config(SHORT))
    config = SlaveConfig(rig=rig_config(SHORT), gate=GATE, initialise=but(KNOWN, at_start=True))
    found = initialise(rig, config, procedure_run.generate_fast_ticks(500.0), 0)
    assert found.calibration.rig == "bench"
    assert found.calibration.method.endswith("quick form")
    assert len(found.samples) == len(found.record.time)
    assert np.diff([sample.time_s for sample in found.samples]).min() > 0.0
    swing = np.array([sample.proximal_tension for sample in found.samples])
    assert (swing.max(axis=0) / swing[-1]).min() > np.exp(2.0)  # the estimators' past is erased


@pytest.mark.slow
def test_a_range_that_was_found_once_is_expected_again(done, capsys):
    words = ["--set", "slave.rig.joints.0.body.stops=[-0.003, 0.001]", "--quick", "--joint", 1]
    out = done / "bench-calibration.yaml"
    before = out.read_text()
    assert teleop("--config", done / "rig.yaml", *words, "--out", out) == 1
    said = capsys.readouterr().err
    assert "joint 1: it travels 4.0 mm between its stops, expected 6.0 mm" in said
    assert out.read_text() == before
