"""Limits of the gates have bounds, which only an explicit key lifts."""

from pathlib import Path

import pytest

from master import gate as master_gate
from master.config import MasterConfig
from slave import gate as slave_gate
from slave.config import SlaveConfig, find_config_warnings
from teleop.config.bounds import build_bounds_warnings
from teleop.config.loading import load
from teleop.errors import UsageError

SECTIONS = {
    "master": (MasterConfig, master_gate.BOUNDS),
    "slave": (SlaveConfig, slave_gate.BOUNDS),
}
LIMITS = [(section, bound) for section, (_, bounds) in SECTIONS.items() for bound in bounds]


@pytest.mark.parametrize(("section", "bound"), LIMITS, ids=lambda x: getattr(x, "name", x))
def test_a_limit_beyond_its_bound_needs_the_explicit_key(section, bound):
    cls = SECTIONS[section][0]
    sign = -1 if bound.name.endswith("_min") else 1
    key = f"{section}.gate.{bound.name}"
    load(None, cls, section, [f"{key}={sign * bound.most}"])
    above = f"{key}={sign * bound.most * 1.01}"
    with pytest.raises(UsageError, match=rf"{key}.*{bound.most:g} {bound.unit}") as refused:
        load(None, cls, section, [above])
    assert "exceed_bounds: true" in str(refused.value)
    assert "\n" not in str(refused.value)
    config = load(None, cls, section, [above, f"{section}.gate.exceed_bounds=true"])
    (warning,) = build_bounds_warnings(f"{section}.gate", config.gate)
    assert f"{section}.gate.exceed_bounds" in warning
    assert build_bounds_warnings(section, cls().gate) == []


def test_the_slave_warns_of_lifted_bounds():
    (line,) = find_config_warnings(SlaveConfig(gate=slave_gate.GateConfig(exceed_bounds=True)))
    assert "exceed_bounds" in line


def test_every_bound_is_in_the_docs():
    text = (Path(__file__).parents[2] / "docs" / "explanation" / "safety.md").read_text()
    for section, bound in LIMITS:
        value = f"{bound.most * 1e3:g} mm" if bound.unit == "m" else f"{bound.most:g} {bound.unit}"
        assert f"| `{section}.gate.{bound.name}` | {value} |" in text
