import sys

import pytest

from master.devices.hid import device
from master.devices.hid.device import CLAIMS
from tests.hid.fake_hidraw import FakeHidraw


@pytest.fixture
def hidraw(monkeypatch, tmp_path):
    """The fake module in place of hidapi's; nothing forbidden was done to it in the end."""
    folder = tmp_path / "dev"
    folder.mkdir()
    bus = FakeHidraw(folder)
    monkeypatch.setitem(sys.modules, "hidraw", bus)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr("teleop.runtime.machine.find_container", lambda: "")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setattr(device, "POLL_PERIOD_S", 0.02)  # of looks for a device that is away
    CLAIMS.forget()
    yield bus
    assert bus.misuse == []
