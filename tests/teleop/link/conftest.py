"""Links settle quickly here, but where that is what is tested."""

import pytest

from teleop.link import link as link_module
from tests.teleop.link.bench import free_config

SETTLE_S = link_module.SETTLE_S


@pytest.fixture(autouse=True)
def short_settling(monkeypatch):
    monkeypatch.setattr(link_module, "SETTLE_S", 0.05)


@pytest.fixture
def true_settling(monkeypatch, short_settling):
    monkeypatch.setattr(link_module, "SETTLE_S", SETTLE_S)


@pytest.fixture
def config():
    return free_config()
