"""The configs that come with the project: each rig can be calibrated, as its file says how."""

from contextlib import ExitStack
from pathlib import Path

import pytest

from master.config import MasterConfig
from slave.calibration import calibration_file
from slave.config import SlaveConfig, find_not_ready_reason, load_tendon_configs
from slave.rigs import open_rig
from teleop.cli import commands
from teleop.config.loading import as_tree, load
from teleop.errors import UsageError
from teleop.session.state_machine import State
from tests.tick.session import Session

FOLDER = Path(__file__).parents[2] / "configs"
WHOLE = {path.stem: path.read_text() for path in sorted(FOLDER.glob("*.yaml"))}
HARDWARE = [name for name, text in WHOLE.items() if "type: hardware" in text]
# the arm of another config: minutes for nothing new; n + 1 tendons, which are not calibrated
LEFT_OUT = ["two-notes-arms", "endoscope-three-tendons"]
NAMES = [name for name in WHOLE if "\nslave:" in WHOLE[name] and name not in HARDWARE + LEFT_OUT]
ARMS = [name for name in NAMES if "\narms:" in WHOLE[name]]
SURE = 3.0  # standard uncertainties
UNCERTAIN = 0.05  # of K: an uncertainty above says nothing


def leaves(tree, place=()):
    """Yield the place and the value of each number and word in plain YAML values."""
    if not isinstance(tree, dict | list):
        yield place, tree
        return
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        yield from leaves(value, (*place, str(key)))


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("arm", "rig.joints.1.body.stops.0", -0.003),
        ("arm", "rig.joints.0.tendons.1.sheath.friction", 0.2),
        ("two-arms", "rig.joints.2.tendons.0.sheath.sections.1.radius", 0.5),
        ("paper-joint", "rig.joints.0.tendons.1.sheath.axial_stiffness", 8000.0),
    ],
)
def test_an_override_of_one_joint_or_tendon_changes_no_other(name, key, value):
    path = FOLDER / f"{name}.yaml"
    before = dict(leaves(as_tree(load(path, SlaveConfig, "slave"))))
    changed = load(path, SlaveConfig, "slave", [f"slave.{key}={value}"])
    place = tuple(key.split("."))
    assert dict(leaves(as_tree(changed))) == before | {place: value}
    assert before[place] != value


def calibrate(name, out, *options):
    words = ["--config", str(FOLDER / f"{name}.yaml")]
    words += (
        []
        if name in ARMS
        else [*("--together", "--set", "rate_hz=500", "--set", "slave.rig.period=0.002")]
    )
    return commands.main(["calibrate", *words, *options, "--out", str(out)])


def of_each(name):
    return pytest.param(name, marks=pytest.mark.slow)


@pytest.fixture(scope="module", params=map(of_each, NAMES))
def done(request, tmp_path_factory):
    """Return a config's name, and the file that the command in it has written."""
    out = tmp_path_factory.mktemp("configs") / "calibration.yaml"
    assert calibrate(request.param, out, "--quick") == 0
    return request.param, out


def true_sheaths(config):
    """Return K and EA/L [N/m] of every tendon."""
    for tendon in (t for joint in config.rig.joints for t in joint.tendons):
        sections = tendon.sheath.sections
        bend = sum(s.length / s.radius for s in sections)
        length = sum(s.length for s in sections)
        yield tendon.sheath.friction * bend, tendon.sheath.axial_stiffness / length


def test_as_its_file_says_a_rig_is_calibrated_and_every_sheath_found(done):
    require_true_sheaths(*done)


@pytest.mark.slow
def test_all_loops_of_an_endoscope_tell_its_sheaths_too(tmp_path):
    out = tmp_path / "calibration.yaml"
    assert calibrate("endoscope-tip", out) == 0
    require_true_sheaths("endoscope-tip", out)


def require_true_sheaths(name, out):
    found = calibration_file.load(out).directions
    true = list(true_sheaths(load(FOLDER / f"{name}.yaml", SlaveConfig, "slave")))
    assert len(found) == len(true)
    for direction, (K, stiffness) in zip(found, true, strict=True):
        assert abs(direction.K.value - K) <= SURE * direction.K.uncertainty
        assert direction.K.uncertainty < UNCERTAIN * K
        assert direction.stiffness_per_length.value == pytest.approx(stiffness, rel=0.01)


def test_the_slave_of_the_config_as_it_is_takes_the_file(done):
    name, out = done
    use_it = [f"slave.calibration={out}"]
    config = load(FOLDER / f"{name}.yaml", SlaveConfig, "slave", use_it)
    rig = open_rig(config.rig)
    assert find_not_ready_reason(config, rig) == ""
    true = true_sheaths(config)
    for tendon, (K, _) in zip(load_tendon_configs(config, rig.tendons), true, strict=True):
        accepted = tendon.build_model().sheath.K
        assert abs(accepted - K) <= SURE / 2.0 * tendon.friction_error * K  # that is two sigma


@pytest.mark.parametrize("name", HARDWARE)
def test_a_config_to_start_from_is_right_but_for_the_port(name):
    config = load(FOLDER / f"{name}.yaml", SlaveConfig, "slave")
    load(FOLDER / f"{name}.yaml", MasterConfig, "master")
    assert config.rig.motors.type == name
    assert config.control.tension_max < config.gate.tension_max <= 10.0
    with pytest.raises(UsageError, match="cannot be opened"):
        open_rig(config.rig)


@pytest.mark.slow
@pytest.mark.parametrize("done", ARMS, indirect=True)
def test_a_session_with_the_file_of_an_arm_engages(done):
    name, out = done
    with ExitStack() as stack:
        session = Session(stack, (f"slave.calibration={out}",), file=FOLDER / f"{name}.yaml")
        for _ in range(1500):
            session.tick()
        assert int(session.master.memory.session.state) == State.ENGAGED


def test_what_a_simulated_tip_touches_is_taken_away(tmp_path, capsys):
    out = tmp_path / "calibration.yaml"
    assert calibrate("demo", out) == 0
    assert "calibrated without what its joints and tips touch" in capsys.readouterr().err
    assert calibration_file.load(out).accepted
