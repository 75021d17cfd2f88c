import re
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from slave.calibration import calibration_file
from slave.calibration.calibration_file import (
    Calibration,
    TendonCalibration,
    ValueWithUncertainty,
    find_misfit,
)
from slave.config import SlaveConfig, find_not_ready_reason, load_tendon_configs
from slave.rigs.replayed_data import ReplayedRigConfig
from slave.sheath_section import SectionConfig
from slave.tendon_config import TendonConfig
from teleop.errors import UsageError
from tests.slave.calibration.calibration_bench import joint, rig_config

EVEN = TendonConfig(effective_friction=1.02, axial_stiffness=8990.0, friction_error=0.03)
UNEVEN = TendonConfig(
    friction=0.1, sections=(SectionConfig(0.3), SectionConfig(1.2, 0.12)), tension_noise=0.01
)
WHOLE = Calibration(
    rig="arm",
    joints=((0, 1),),
    time="2026-03-01T12:00:00+00:00",
    method="pulls and releases against the stops, quick form",
    tendons=(EVEN, UNEVEN),
    directions=(
        TendonCalibration(
            joint=1,
            tendon="a",
            K=ValueWithUncertainty(1.02, 0.004),
            K_slopes=ValueWithUncertainty(1.03, 0.01),
            K_paper=ValueWithUncertainty(1.1, 0.05),
            M_pull=ValueWithUncertainty(1.05e-4, 1e-7),
            M_rel=ValueWithUncertainty(2.8e-4, 3e-7),
            stiffness_per_length=ValueWithUncertainty(5990.0, 12.0),
            uniform=True,
            stop=0.0148,
            free_tension=1.8,
            zero=0.002,
            remark="the sheath is bent unevenly: K = 1.02 stands",
        ),
    ),
    ranges=(0.03, None),
)


@dataclass
class Rig:
    name: str = "arm"
    joints: tuple = ((0, 1),)


def saved(tmp_path, calibration=WHOLE):
    path = tmp_path / "arm.yaml"
    calibration_file.save(path, calibration)
    return path


def test_what_is_saved_is_what_is_loaded(tmp_path):
    assert calibration_file.load(saved(tmp_path)) == WHOLE


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = saved(tmp_path)
    before = path.read_text()

    def broken(self, _text):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", broken)
    with pytest.raises(UsageError, match="the calibration cannot be written: No space left"):
        calibration_file.save(path, replace(WHOLE, rig="other"))
    assert path.read_text() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("tendons: []", "tendons: "),
        ("rig: arm", "tendons: is missing"),
        ("tendons: [{effective_friction: 1}]\njoints: [[0, 1]]", "joints: must name each"),
        ("tendons: [{effective_friction: 1}]\nspeed: 3", "speed: unknown key"),
    ],
)
def test_what_is_no_calibration_is_said_in_one_line(tmp_path, text, said):
    path = tmp_path / "arm.yaml"
    path.write_text(text)
    with pytest.raises(UsageError, match=said):
        calibration_file.load(path)


@pytest.mark.parametrize(
    ("calibration", "rig", "said"),
    [
        (WHOLE, Rig(name="leg"), "for the rig 'arm', this one is 'leg'"),
        (WHOLE, Rig(joints=((0,), (1,))), r"joints 1\+2 .*the rig has 1, 2"),
        (WHOLE, Rig(joints=((0, 1), (2, 3))), r"the rig has 1\+2, 3\+4"),
        (replace(WHOLE, rig=""), Rig(), "for no named rig"),
        (replace(WHOLE, accepted=False, remark="noisy"), Rig(), "not accepted: noisy"),
        (replace(WHOLE, joints=()), Rig(joints=((0,), (1,), (2,))), "describes 2 tendons"),
    ],
)
def test_it_fits_no_other(calibration, rig, said):
    assert re.search(said, find_misfit(calibration, rig))


# What a slave makes of it.

SIMULATED = rig_config(joint())
BENCH = Rig(name="bench")


def test_without_a_calibration_a_rig_is_barred_even_a_simulated_one():
    config = SlaveConfig(rig=SIMULATED)
    assert "teleop calibrate" in find_not_ready_reason(config, BENCH)
    with pytest.raises(UsageError, match="teleop calibrate"):
        load_tendon_configs(config, 2)


def test_as_built_must_be_asked_for_and_is_for_simulated_rigs_alone(tmp_path):
    config = SlaveConfig(rig=SIMULATED, calibration="as-built")
    assert find_not_ready_reason(config, BENCH) == ""
    models = load_tendon_configs(config, 2)
    assert [model.build_model().sheath.K for model in models] == pytest.approx([1.0, 1.0])
    with pytest.raises(ValueError, match="as-built is only for simulated rigs"):
        SlaveConfig(rig=ReplayedRigConfig(file=tmp_path / "x.csv"), calibration="as-built")


def test_a_file_that_does_not_fit_bars_the_rig_and_says_why(tmp_path):
    config = SlaveConfig(rig=SIMULATED, calibration=saved(tmp_path))
    said = find_not_ready_reason(config, BENCH)
    assert said.startswith("arm.yaml does not fit: it is for the rig 'arm', this one is 'bench'")
    assert "teleop calibrate" in said
    assert "\n" not in said


def test_measured_data_take_the_calibration_of_any_rig_unless_they_have_a_name(tmp_path):
    path = saved(tmp_path, Calibration(tendons=(EVEN,), source="bench.csv, 100 samples"))
    played = SlaveConfig(rig=ReplayedRigConfig(file=tmp_path / "x.csv"), calibration=path)
    rig = Rig(name="x.csv", joints=((0,),))
    assert find_not_ready_reason(played, rig) == ""
    named = replace(played, rig=replace(played.rig, name="leg"))
    assert "for no named rig" in find_not_ready_reason(named, replace(rig, name="leg"))


def test_a_config_or_no_file_in_place_of_a_calibration_is_called_what_it_is(tmp_path):
    path = tmp_path / "demo.yaml"
    with pytest.raises(UsageError, match=r"demo\.yaml: cannot read the calibration"):
        calibration_file.load(path)
    path.write_text("session: demo\nslave: {}\n")
    with pytest.raises(UsageError, match=r"demo\.yaml: is a session config"):
        calibration_file.load(path)
