"""`teleop master` as a command: its summary, and what it says when its device fails."""

import json

import pytest

from master import devices, process
from master.device import DeviceFault
from master.devices.virtual import VirtualConfig
from teleop.errors import TeleopError, UsageError
from teleop.session.state_machine import Reason
from tests.master.test_process import Stylus
from tests.one_side import arguments_of, without_traces


@pytest.fixture
def quiet_process(monkeypatch):
    with without_traces(monkeypatch):
        yield


def arguments(*words):
    return arguments_of(process, *words)


@pytest.mark.usefixtures("quiet_process")
def test_the_command_runs_alone_and_leaves_its_summary(tmp_path, capsys):
    path = tmp_path / "m.json"
    assert process.main(arguments("--duration", "1.2", "--json", str(path))) == 0
    summary = json.loads(path.read_text())
    assert {
        "role", "seconds", "ticks", "rate_hz", "overruns", "lateness_max_ms", "latency_ms",
        "received", "lost", "rejected", "gate", "work_us", "final_state", "reason", "realtime",
    } <= set(summary)  # fmt: skip
    assert summary["role"] == "master"
    assert summary["stopped"] == "duration reached"
    assert summary["gate"] == {"NOT_ENGAGED|STALE_STATE": summary["ticks"]}
    assert summary["latency_ms"]["n"] == 0
    assert f"over {summary['seconds']:.1f} s" in capsys.readouterr().out


@pytest.mark.usefixtures("quiet_process")
def test_a_device_that_is_not_there_is_told_in_a_line(monkeypatch):
    def missing(config):
        raise DeviceFault("/dev/hidraw7: no such device")

    monkeypatch.setitem(devices.DEVICES, VirtualConfig, missing)
    with pytest.raises(UsageError, match=r"^master\.device: /dev/hidraw7: no such device$"):
        process.main(arguments("--duration", "1"))


@pytest.mark.usefixtures("quiet_process")
@pytest.mark.parametrize("error", [DeviceFault, ZeroDivisionError])
def test_the_command_closes_its_device_and_tells_what_failed(monkeypatch, tmp_path, error):
    device = Stylus(read_fails_at=20, error=error)
    monkeypatch.setitem(devices.DEVICES, VirtualConfig, lambda _: device)
    path = tmp_path / "m.json"
    told = TeleopError if error is DeviceFault else error
    with pytest.raises(told, match="unplugged"):
        process.main(arguments("--json", str(path)))
    assert device.closed == 1
    assert device.forces[-1] == (0.0,)
    if error is DeviceFault:
        summary = json.loads(path.read_text())
        assert (summary["final_state"], summary["reason"]) == ("fault", Reason.DEVICE_FAULT.text)
        assert summary["stopped"] == "haptic device: unplugged"
