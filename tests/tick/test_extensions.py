"""An estimator, a controller and a coupling of another package, in a session of both loops."""

import math
import re
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
import pytest

from slave.extensions import ControllerExtension, EstimatorExtension, TipEstimate
from slave.rigs.simulated import SimulatedRig
from teleop.config import extensions
from teleop.config.extension_calls import CheckedExtension, ExtensionFault
from teleop.config.loading import ConfigDocument
from teleop.coupling.extension import CouplingExtension, TipMotion
from teleop.errors import UsageError
from teleop.session.config import RunConfig, SideConfig
from teleop.session.state_machine import Reason, State
from tests.root import ROOT
from tests.tick.session import HAND_ENGAGED, Session

FILE = ROOT / "configs" / "bowden.yaml"
HERE = "tests.tick.test_extensions:"
KEYS = {
    "estimator": ("slave.estimator", "Estimator"),
    "controller": ("slave.controller", "Controller"),
    "slave's coupling": ("coupling", "Coupling"),
    "master's coupling": ("coupling", "Coupling"),
    "master's render": ("coupling", "Coupling"),
}
DELAYS = {"late": 0.025, "slow": 0.012}  # [s]
act: dict[str, object] = {}  # what an extension does from now on, by kind


def spoil(kind, values):
    """What an extension of a kind returns: `values`, unless it has been told otherwise."""
    mistake = act.get(kind)
    if mistake == "raise":
        raise ZeroDivisionError("by its own code")
    if mistake in DELAYS:
        act["sleep"](DELAYS[mistake])
    wrong = {
        "nan": np.full(1, np.nan),
        "shape": np.zeros((1, 2)),
        "type": [0.0],
        "large": np.full(1, 1.0),  # [m]
    }
    return wrong.get(mistake, values)


@dataclass(frozen=True)
class Estimator(EstimatorExtension):
    share: float = 0.5

    def open(self, models):
        assert len(models) == 1
        return self

    def step(self, sample):
        tip = spoil("estimator", self.share * sample.tension)
        low = tip + 1.0 if act.get("estimator") == "order" else tip
        return TipEstimate(tip, low, tip, np.zeros(1))


@dataclass(frozen=True)
class Controller(ControllerExtension):
    def open(self, joints):
        assert joints == ((0,),)
        return self

    def step(self, state):
        if state.is_first:
            act["origin"] = state.motor - state.command
        assert state.tension.flags.owndata
        act["target"] = act["origin"] + state.command
        return spoil("controller", act["target"])


@dataclass(frozen=True)
class Coupling(CouplingExtension):
    force: float = 3.0

    def open_master(self, _joints):
        return self

    open_slave = open_master

    def send(self, hand):
        act["calls"] = act.get("calls", 0) + 1
        return spoil("master's coupling", hand.position)

    def render(self, tip_force, received):
        act["received"] = float(received[0])
        return spoil("master's render", np.full_like(tip_force, self.force))

    def move(self, tip):
        if tip.is_first:
            act["offset"] = tip.position - 0.5 * tip.received
        position = act["offset"] + 0.5 * tip.received
        position = spoil("slave's coupling", position)
        return TipMotion(position, np.zeros(1), 2.0 * tip.received)


@pytest.fixture(autouse=True)
def allowed(monkeypatch):
    monkeypatch.setattr(extensions, "policy", extensions.ImportPolicy(any_module=True))
    act.clear()


def start(stack, *settings):
    hand = (*HAND_ENGAGED, "master.device.reference.targets=[0.060, 0.0]")
    session = Session(stack, (*hand, *settings), file=FILE)
    act["sleep"] = session._clock.sleep
    return session


def states(session):
    return tuple(State(int(side.memory.session.state)) for side in (session.slave, session.master))


def drive(session, ticks):
    """Motor positions, hand forces and joint estimates of so many ticks."""
    rows = []
    for _ in range(ticks):
        session.tick()
        memory = session.slave.memory
        joint = memory.joints[0]
        tendon = memory.tendons[0]
        rows.append(
            (
                memory.gated_position[0],
                session.master._force[0],
                joint.position,
                joint.force,
                tendon.tension,
            )
        )
    return np.array(rows).T


def test_its_estimate_is_that_of_the_joint():
    with ExitStack() as stack:
        session = start(stack, f"slave.estimator={{type: '{HERE}Estimator', share: 0.25}}")
        *_, force, tension = drive(session, 300)
        assert states(session) == (State.ENGAGED, State.ENGAGED)
    assert np.ptp(tension) > 2.0
    assert force[5:] == pytest.approx(0.25 * tension[5:], abs=1e-12)


def test_its_motor_targets_are_followed_within_the_gate():
    with ExitStack() as stack:
        session = start(stack, f"slave.controller={{type: '{HERE}Controller'}}")
        motor, *_ = drive(session, 400)
        assert states(session) == (State.ENGAGED, State.ENGAGED)
        assert motor[-1] == pytest.approx(act["target"][0], abs=1e-12)
        act["controller"] = "large"  # far beyond the gate's range: a mistake of units
        spoiled, *_ = drive(session, 1)
    assert np.ptp(motor) > 2e-3
    assert np.abs(np.diff(motor)).max() <= 0.070 * 1.001e-3 * 1.5
    assert spoiled[0] == motor[-1]


def test_its_motion_and_its_force_go_through_to_tip_and_hand():
    with ExitStack() as stack:
        session = start(stack, f"coupling={{type: '{HERE}Coupling', force: 3.0}}")
        _, felt, *_ = drive(session, 300)
        side = session.slave.memory.coupling
        assert states(session) == (State.ENGAGED, State.ENGAGED)
        requested = session.master.memory.coupling.requested[0]
        assert side.tip[0] == pytest.approx(act["offset"][0] + 0.5 * requested, abs=1e-9)
        assert act["received"] == pytest.approx(2.0 * requested, abs=1e-9)
    assert requested > 3e-3
    assert felt[-1] == pytest.approx(-0.1 * 3.0)  # force.scale of the config


def test_a_command_is_decided_again_after_a_stall_of_the_coupling():
    with ExitStack() as stack:
        session = start(stack, f"coupling={{type: '{HERE}Coupling'}}")
        drive(session, 150)
        session.alter(None, lambda _: None)  # the slave falls silent
        drive(session, 22)
        assert session.master._command.records["state"] == State.ENGAGED
        act["master's coupling"], calls = "slow", act["calls"]
        session.tick()
        command = session.master._command.records
    assert act["calls"] == calls + 1
    assert command["state"] == State.HOLDING
    assert command["wave"][0, 0] == 0.0


@pytest.mark.parametrize(
    "values",
    [
        np.array([-(2**63)]),
        np.ma.array([1e300, 0.0], mask=[True, False]),
        np.ma.array([math.nan], mask=[True]),
        np.array([np.longdouble("1e400")]),
        np.array([-1.5], np.float16),
    ],
    ids=str,
)
def test_no_number_beyond_the_limit_hides_in_an_array(values):
    checked = CheckedExtension("coupling", Coupling("x"), object)
    with pytest.raises(ExtensionFault, match=r"not finite|at most 1 N"), np.errstate(all="ignore"):
        checked.check("move", "force", values, len(values), 1.0, "N")


MISTAKES = {
    "nan": "not finite",
    "raise": "ZeroDivisionError: by its own code",
    "shape": r"has shape \(1, 2\), must be \(1,\)",
    "type": "is a list, must be an array",
    "large": "at most",
    "late": "took 25 ms",
    "order": "is not between low",
}


@pytest.mark.parametrize(
    ("kind", "mistake"),
    [
        *((kind, "nan") for kind in KEYS),
        *(("controller", "late"), ("master's render", "late")),
        *(("controller", mistake) for mistake in ("raise", "shape", "type", "large")),
        ("estimator", "order"),
    ],
)
def test_a_mistake_is_one_fault_that_moves_and_is_felt_no_more(kind, mistake):
    key, name = KEYS[kind]
    with ExitStack() as stack:
        session = start(stack, f"{key}={{type: '{HERE}{name}'}}")
        written = []
        write = SimulatedRig.write
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.setattr(SimulatedRig, "write", lambda rig, x: (written.append(x[0]), write(rig, x)))
        drive(session, 150)
        assert states(session) == (State.ENGAGED, State.ENGAGED)
        act[kind] = mistake
        before = written[-1]
        at_master = kind.startswith("master")
        failed, peer = (
            (session.master, session.slave) if at_master else (session.slave, session.master)
        )
        drive(session, 2)
        session.master._device.write((0.0,))
        assert failed.memory.session.state == State.FAULT
        assert failed.memory.session.reason == Reason.EXTENSION_FAULT
        assert peer.memory.session.state == State.FAULT
        assert peer.memory.session.reason in (Reason.PEER_FAULT, Reason.PEER_LEFT)
        line = failed.ended
        assert session.master._force[0] == 0.0
        assert np.abs(np.diff([before, *written[len(written) - 3 :]])).max() < 1e-4
    assert line.startswith(f"{key}: ")
    assert line.endswith(f"or leave {key} out for the built-in one")
    assert "\n" not in line
    assert re.search(MISTAKES[mistake], line)


EXAMPLES = {
    "slave.estimator": "mylab.estimator:CapstanConfig",
    "slave.controller": "mylab.controller:FloorConfig",
    "coupling": "mylab.coupling:LagConfig",
}


@pytest.mark.parametrize("key", EXAMPLES)
def test_the_example_of_each_moves_the_joint_and_is_felt(key, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "examples" / "own_package" / "src")
    with ExitStack() as stack:
        session = start(stack, f"{key}={{type: '{EXAMPLES[key]}'}}")
        rows, true = [], []
        for _ in range(800):
            session.tick()
            joint = session.slave.memory.joints[0]
            requested = session.master.memory.coupling.requested[0]
            rows.append((requested, joint.position, joint.force, session.master._force[0]))
            true.append(session.slave._rig._states[0].travel)
        requested, position, force, felt = np.array(rows).T
        assert states(session) == (State.ENGAGED, State.ENGAGED)
    assert true[-1] - true[50] == pytest.approx(requested[-1] - requested[50], abs=1.5e-3)
    assert position[-1] - position[50] == pytest.approx(true[-1] - true[50], abs=1e-3)
    assert force[-1] > 2.0
    assert felt[-1] < -0.1


def test_a_stop_a_view_or_a_recorder_needs_no_code_of_a_coupling():
    document = ConfigDocument.read(FILE, ["coupling={type: 'not.installed:Here'}"])
    assert document.load(RunConfig).rate_hz == 1000.0
    with pytest.raises(UsageError, match="coupling"):
        document.load(SideConfig)


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        (
            "slave.estimator={type: 'mylab.controller:FloorConfig'}",
            "must be a subclass of slave.ex",
        ),
        (
            "slave.estimator={type: 'mylab.estimator:CapstanConfig', band: 1}",
            "slave.estimator.band",
        ),
        (f"slave.controller={{type: '{HERE}Unfinished'}}", "slave.controller: object has no step"),
        (f"coupling={{type: '{HERE}Coupling', force: strong}}", "coupling.force: 'strong' is not"),
    ],
)
def test_a_wrong_config_is_one_line_with_key_and_reason(setting, says, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "examples" / "own_package" / "src")
    with ExitStack() as stack, pytest.raises(UsageError, match=says):
        start(stack, setting)


@dataclass(frozen=True)
class Unfinished(ControllerExtension):
    def open(self, _joints):
        return object()
