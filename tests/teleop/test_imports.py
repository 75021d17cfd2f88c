"""A config or a model file of somebody else runs no code, unless the user says that it may."""

import os
import subprocess
import sys

import pytest
import yaml

from teleop.cli.diagnose.diagnosis_run import parse_effects
from teleop.config import extensions

STRANGER = """
from dataclasses import dataclass
from estimator.effects.effect import DISTAL_TENSION, Effect, Parameter
from master.devices.extension import DeviceExtension
from slave.rigs.extension import RigExtension
import builtins
builtins.stranger_ran = True

@dataclass(frozen=True)
class Rig(RigExtension): ...

@dataclass(frozen=True)
class Device(DeviceExtension): ...

CURVE = Effect("curve", "c", "e", (Parameter("curve", "1/N", -1.0, 1.0, 0.1),), "s", "a",
               starts=lambda _: [(0.1,)], required_channels=frozenset({DISTAL_TENSION}))
"""
RIG = {"slave": {"rig": {"type": "stranger:Rig"}}}
OWN = {"type": "stranger:Own"}
DEVICE = {"master": {"device": {"type": "stranger:Device"}}}
MODEL = {
    "base": {"K": 0.8},
    "duration": 60.0,
    "effects": [{"name": "stranger:CURVE", "parameters": {"curve": 0.01}}],
}
FILE_USES = {  # command, its file, and the key to be named
    "run": ("run --view none --config {}", RIG, "slave.rig.type"),
    "run with a device": ("run --view none --config {}", DEVICE, "master.device.type"),
    "slave": ("slave --config {}", RIG, "slave.rig.type"),
    "master": ("master --config {}", DEVICE, "master.device.type"),
    "slave with an estimator": (
        "slave --config {}",
        {"slave": {"estimator": OWN}},
        "slave.estimator.type",
    ),
    "slave with a controller": (
        "slave --config {}",
        {"slave": {"controller": OWN}},
        "slave.controller.type",
    ),
    "master with a coupling": ("master --config {}", {"coupling": OWN}, "coupling.type"),
    "calibrate": ("calibrate --config {}", RIG, "slave.rig.type"),
    "rig": ("rig check --config {}", RIG, "slave.rig.type"),
    "simulate": ("simulate {} --out out.csv", RIG, "slave.rig.type"),
    "estimate": ("estimate data.csv --model {}", MODEL, "effects.0.name"),
}


@pytest.fixture
def stranger(tmp_path, monkeypatch):
    """An installed module that no package declares; whether it ran."""
    site, here = tmp_path / "site", tmp_path / "here"
    site.mkdir()
    here.mkdir()
    (site / "stranger.py").write_text(STRANGER)
    (here / "data.csv").write_text("time_s,proximal_tension_N\n0,1\n0.1,2\n0.2,3\n0.3,1\n")
    monkeypatch.chdir(here)
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setattr(extensions, "policy", extensions.ImportPolicy())
    yield lambda: "stranger" in sys.modules
    sys.modules.pop("stranger", None)


@pytest.mark.parametrize("use", FILE_USES)
def test_a_file_that_names_code_is_refused_with_file_key_and_option(
    stranger, tmp_path, refused, use
):
    words, content, key = FILE_USES[use]
    path = tmp_path / "file.yaml"
    path.write_text(yaml.safe_dump(content))
    line = refused(*words.format(path).split())
    assert line.startswith(f"teleop: {path}: {key}: stranger:")
    assert line.endswith("add --allow-imports")
    assert not stranger()


def test_an_effect_on_the_command_line_needs_the_option_too(stranger, refused):
    assert "--allow-imports" in refused("diagnose", "data.csv", "--effects", "stranger:CURVE")
    assert not stranger()
    extensions.allow_imports()
    (effect,) = parse_effects("stranger:CURVE")
    assert effect.name == "stranger:CURVE"


def test_nothing_is_imported_from_the_current_folder(tmp_path):
    """Neither by a name, nor by an entry point that a folder there declares."""
    (tmp_path / "stranger.py").write_text(STRANGER + "\nopen('ran', 'w').close()\n")
    info = tmp_path / "stranger-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[teleop.rigs]\nstranger = stranger:Rig\n")
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    for name, says in (("stranger", "'stranger' is unknown"), ("stranger:Rig", "no module")):
        ended = subprocess.run(
            [sys.executable, "-m", "teleop", "slave", "--allow-imports",
             "--set", f"slave.rig.type={name}"],
            cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert (ended.returncode, says in ended.stderr) == (2, True), ended.stderr
        assert not (tmp_path / "ran").exists()
