"""A package of a laboratory's own, installed: its rig, its device and its effect are used."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "examples" / "own_package"

RIG = """
from pathlib import Path
from slave.config import SlaveConfig
from slave.rigs import open_rig
from teleop.config.loading import load
import numpy as np

config = load(None, SlaveConfig, "slave", ["slave.rig={type: %s, stiffness: 1500}"])
rig = open_rig(config.rig)
rig.write(np.array([0.002]))
(sample,) = rig.read(0.1)
print(rig.name, sample.proximal_tension[0])
"""
DEVICE = """
from master.config import MasterConfig
from master.devices import open_device
from teleop.config.loading import load

config = load(None, MasterConfig, "master", ["master.device={type: %s, frequency: 0.25}"])
device = open_device(config.device)
print(device.axes, device.read(1.0).position[0], device.read(1.0).engage)
"""
EFFECT = """
from pathlib import Path
import numpy as np
from estimator.diagnosis.dataset import Model
from teleop.data import model_file
from teleop.cli.diagnose.command import parse_effects

(effect,) = parse_effects("%s")
path = Path("model.yaml")
base = model_file.SavedModel(Model((0.8,), (), ((effect, (0.01,)),)), 10.0, (), False)
model_file.save(path, base, "of a test")
((again, values),) = model_file.load(path).model.effects
assert again.name == effect.name, (again.name, effect.name)
print(effect.name, values[0])
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder that the package is installed into, with its entry points."""
    target = tmp_path_factory.mktemp("site")
    words = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--target", str(target)]
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", *words]
    subprocess.run([*pip, str(PACKAGE)], check=True)
    return target


def python(installed, folder, code):
    ended = subprocess.run(
        [sys.executable, "-c", code],
        env={"PATH": "/usr/bin:/bin", "PYTHONPATH": f"{installed}:{ROOT}", "HOME": str(folder)},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.split()


@pytest.mark.parametrize("name", ["mylab", "mylab.rig:SpringRigConfig"])
def test_its_rig_is_opened_with_the_keys_of_the_config(installed, tmp_path, name):
    assert python(installed, tmp_path, RIG % name) == ["spring", "3.0"]


@pytest.mark.parametrize("name", ["mylab", "mylab.device:SineHandConfig"])
def test_its_device_is_opened(installed, tmp_path, name):
    axes, position, engage = python(installed, tmp_path, DEVICE % name)
    assert (axes, engage) == ("1", "True")
    assert float(position) == pytest.approx(0.01)


@pytest.mark.parametrize("name", ["mylab-curve", "mylab.effect:DISTAL_TENSION_CURVE"])
def test_its_effect_is_chosen_saved_and_loaded(installed, tmp_path, name):
    assert python(installed, tmp_path, EFFECT % name) == [name, "0.01"]


@pytest.mark.parametrize(
    ("rig", "said"),
    [
        ("{type: mylab, stifness: 1}", "slave.rig.stifness: unknown key; did you mean 'stiffness'"),
        ("{type: mylab, stiffness: -1}", "slave.rig.stiffness: -1.0: must be above 0"),
        ("{type: 'mylab.rig:Nothing'}", "mylab.rig has no 'Nothing'"),
        (
            "{type: 'mylab.rig:SpringRig'}",
            "must be a subclass of slave.rigs.extension:",
        ),
        ("{type: 'nobody.rig:Rig'}", "no module 'nobody'; install its package"),
        ("{type: mylb}", "'mylb' is unknown"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_place(installed, tmp_path, rig, said):
    code = f"""
from teleop.cli import commands
assert commands.main(["slave", "--allow-imports", "--set", "slave.rig={rig}"]) == 2
"""
    ended = subprocess.run(
        [sys.executable, "-c", code],
        env={"PATH": "/usr/bin:/bin", "PYTHONPATH": f"{installed}:{ROOT}", "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert len(ended.stderr.splitlines()) == 1
    assert said in ended.stderr
