import sys

import pytest

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
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    CLAIMS.forget()
    yield bus
    assert bus.misuse == []
