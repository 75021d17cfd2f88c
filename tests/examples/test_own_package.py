"""A package of a laboratory's own, installed: what it has is used."""

import subprocess
import sys
from pathlib import Path

import pytest

from estimator.compile_cache import choose_folder

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
METHODS = """
from slave.config import SlaveConfig
from teleop.config.loading import load
from teleop.session.config import SideConfig

slave = load(None, SlaveConfig, "slave", ["slave.estimator.type=%s", "slave.controller.type=%s"])
shared = load(None, SideConfig, None, ["coupling={type: %s, time_constant: 0.1}"])
print(slave.estimator.dead_band, slave.controller.gain, shared.coupling.time_constant)
"""
EFFECT = """
from pathlib import Path
import numpy as np
from estimator.diagnosis.dataset import Model
from teleop.data import model_file
from teleop.cli.diagnose.diagnosis_run import parse_effects

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
    """Run code where the package is installed; return what it prints."""
    ended = subprocess.run(
        [sys.executable, "-c", code],
        env={
            "PATH": "/usr/bin:/bin",
            "PYTHONPATH": f"{installed}:{ROOT}",
            "HOME": str(folder),
            "NUMBA_CACHE_DIR": str(choose_folder() or ""),  # or all is compiled anew
        },
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    return ended


def test_what_it_has_is_used_by_either_name(installed, tmp_path):
    names = (
        ("mylab", "mylab", ("mylab-capstan", "mylab-floor", "mylab-lag"), "mylab-curve"),
        (
            *("mylab.rig:SpringRigConfig", "mylab.device:SineHandConfig"),
            (
                *("mylab.estimator:CapstanConfig", "mylab.controller:FloorConfig"),
                "mylab.coupling:LagConfig",
            ),
            "mylab.effect:DISTAL_TENSION_CURVE",
        ),
    )
    code = "".join(
        RIG % rig + DEVICE % device + METHODS % methods + EFFECT % effect
        for rig, device, methods, effect in names
    )
    lines = python(installed, tmp_path, code).stdout.splitlines()
    for (*_, effect), of_rig, of_device, of_methods, of_effect in zip(
        names, lines[::4], lines[1::4], lines[2::4], lines[3::4], strict=True
    ):
        assert of_rig == "spring 3.0"
        axes, position, engage = of_device.split()
        assert (axes, engage) == ("1", "True")
        assert float(position) == pytest.approx(0.01)
        assert of_methods == "2e-05 0.02 0.1"
        assert of_effect == f"{effect} 0.01"


MISTAKES = {
    "{type: mylab, stifness: 1}": "slave.rig.stifness: unknown key; did you mean 'stiffness'",
    "{type: mylab, stiffness: -1}": "slave.rig.stiffness: -1.0: must be above 0",
    "{type: 'mylab.rig:Nothing'}": "mylab.rig has no 'Nothing'",
    "{type: 'mylab.rig:SpringRig'}": "must be a subclass of slave.rigs.extension:",
    "{type: 'nobody.rig:Rig'}": "no module 'nobody'; install its package",
    "{type: mylb}": "'mylb' is unknown",
}


def test_a_mistake_is_one_line_that_names_the_place(installed, tmp_path):
    code = f"""
from teleop.cli import commands
for rig in {list(MISTAKES)}:
    assert commands.main(["slave", "--allow-imports", "--set", "slave.rig=" + rig]) == 2
"""
    lines = python(installed, tmp_path, code).stderr.splitlines()
    for line, said in zip(lines, MISTAKES.values(), strict=True):
        assert said in line


# its calls are those of forcedimension-core 1.0; what it is told is printed
LIBRARY = """
from types import SimpleNamespace
lost = False
def told(name, result=0):
    return lambda *values: print(name, *values) or result
open, close = told("open"), told("close")
enableForce, setForce = told("enableForce"), told("setForce")
expert = SimpleNamespace(setWatchdog=told("setWatchdog"))
def getButton(index):
    return int(index == 1)
def getPosition(out):
    out[:] = 0.01, -0.02, 0.03
    return -1 if lost else 0
def getLinearVelocity(out):
    out[:] = 0.1, 0.0, -0.2
    return 0
def errorGetLastStr():
    return "communication error"
"""
OMEGA = """
from forcedimension_core import dhd
from master.config import MasterConfig
from master.device import DeviceLost
from master.devices import open_device
from teleop.config.loading import load
from teleop.errors import UsageError

config = load(None, MasterConfig, "master", ["master.device={type: omega, engage_button: 1}"])
device = open_device(config.device)
print(device.read(0.0))
device.write((1.0, 2.0, -3.0))
dhd.lost = True
try:
    device.read(0.1)
except DeviceLost as lost:
    print(lost)
device.close()
dhd.expert.setWatchdog = lambda _: -1
try:
    open_device(config.device)
except UsageError as refused:
    print(refused)
"""


def test_an_arm_with_a_library_of_its_maker_is_read_and_pushed(installed, tmp_path):
    library = installed / "forcedimension_core"
    library.mkdir()
    (library / "__init__.py").touch()
    (library / "dhd.py").write_text(LIBRARY)
    *begun, hand, force, lost, zero, off, closed, again, left, refused = python(
        installed, tmp_path, OMEGA
    ).stdout.splitlines()
    assert begun == ["open", "setWatchdog 240", "enableForce True"]
    assert hand.startswith(
        "HandState(position=(0.01, -0.02, 0.03), velocity=(0.1, 0.0, -0.2), engage=True, clutch=F"
    )
    assert (force, lost) == ("setForce (1.0, 2.0, -3.0)", "omega: communication error")
    assert (zero, off, closed) == ("setForce (0.0, 0.0, 0.0)", "enableForce False", "close")
    assert (again, left) == ("open", "close")
    assert refused.startswith("master.device: omega: it has no watchdog, so a force stays if")
