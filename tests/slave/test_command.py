"""`teleop slave`, alone in this process: its summary, its exit code, and what it says of a rig."""

import json

import pytest

from slave import process, rigs
from slave.rig import RigFault
from slave.rigs.simulated import SimulatedRigConfig
from teleop.errors import TeleopError, UsageError
from teleop.messages.messages import MAX_JOINTS
from teleop.session.state_machine import Reason
from tests.one_side import arguments_of, without_traces
from tests.slave.test_process import FakeRig


@pytest.fixture(autouse=True)
def quiet_process(monkeypatch):
    with without_traces(monkeypatch):
        yield


def arguments(*words):
    return arguments_of(process, "--set=slave.calibration=as-built", *words)


def test_the_command_runs_alone_and_leaves_its_summary(tmp_path):
    path = tmp_path / "s.json"
    assert process.main(arguments("--duration", "0.5", "--json", str(path))) == 0
    summary = json.loads(path.read_text())
    assert summary["role"] == "slave"
    assert summary["stopped"] == "duration reached"
    assert summary["gate"] == {"HELD": summary["ticks"]}
    assert summary["final_state"] == "ready"
    assert summary["rig"]["coarse_reads"] >= 0
    assert summary["force_error"]["samples"] > 0


def test_alone_too_a_fault_that_lasts_to_the_end_is_exit_code_1(monkeypatch):
    class Silent(FakeRig):
        def read(self, time_s):
            samples = super().read(time_s)
            return samples if self.reads < 20 else ()

    monkeypatch.setitem(rigs.RIGS, SimulatedRigConfig, lambda _: Silent())
    with pytest.raises(TeleopError, match="a fault of the slave ended the session: "):
        process.main(arguments("--duration", "0.3"))


def test_a_rig_that_is_not_there_is_told_in_a_line(monkeypatch):
    def missing(config):
        raise RigFault("/dev/ttyUSB7: no such device")

    monkeypatch.setitem(rigs.RIGS, SimulatedRigConfig, missing)
    with pytest.raises(UsageError, match=r"^slave\.rig: /dev/ttyUSB7: no such device$"):
        process.main(arguments("--duration", "1"))


TOO_MANY = f"must be 1 to {MAX_JOINTS} joints of 1 or 2 tendons"
NOT_NUMBERED = "must number these from 0, joint after joint"


@pytest.mark.parametrize(
    ("joints", "tendons", "said"),
    [
        (tuple((k,) for k in range(MAX_JOINTS + 1)), MAX_JOINTS + 1, TOO_MANY),
        (((0, 1, 2),), 3, TOO_MANY),
        (((0,), (99,)), 2, NOT_NUMBERED),
        (((0,), (0,)), 2, NOT_NUMBERED),
    ],
)
def test_a_rig_that_is_laid_out_wrong_is_told_in_a_line_and_closed(
    monkeypatch, joints, tendons, said
):
    rig = FakeRig()
    rig.joints, rig.tendons = joints, tendons
    monkeypatch.setitem(rigs.RIGS, SimulatedRigConfig, lambda _: rig)
    with pytest.raises(UsageError, match=rf"^slave\.rig: simulated: joints .*{said}$"):
        process.main(arguments("--duration", "1"))
    assert rig.closed == 1
    assert rig.reads == 0


@pytest.mark.parametrize("error", [RigFault, ZeroDivisionError])
def test_the_command_closes_its_rig_and_tells_what_failed(monkeypatch, tmp_path, error):
    rig = FakeRig(read_fails_at=20, error=error)
    monkeypatch.setitem(rigs.RIGS, SimulatedRigConfig, lambda _: rig)
    path = tmp_path / "s.json"
    told = TeleopError if error is RigFault else error
    with pytest.raises(told, match="the amplifier has tripped"):
        process.main(arguments("--json", str(path)))
    assert rig.closed == 1
    assert rig.after_fault == 0
    if error is RigFault:
        summary = json.loads(path.read_text())
        assert (summary["final_state"], summary["reason"]) == ("fault", Reason.RIG_FAULT.text)
        assert summary["stopped"] == "rig: the amplifier has tripped"


def test_an_effect_that_never_came_on_is_warned_of_at_the_end(capsys):
    effects = "slave.rig.effects=[{type: friction_step, start: 100}, {type: slack}]"
    assert process.main(arguments("--duration", "0.5", "--set", effects)) == 0
    (warning,) = (line for line in capsys.readouterr().out.splitlines() if "WARNING" in line)
    assert "friction_step starts at 100 s" in warning
