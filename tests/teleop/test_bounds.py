"""Limits of the gates have bounds, which only an explicit key lifts."""

import math
from dataclasses import fields
from pathlib import Path

import pytest

from master import gate as master_gate
from master.config import MasterConfig
from slave import gate as slave_gate
from slave.config import SlaveConfig, find_config_warnings
from teleop.config.loading import load
from teleop.config.ranges import build_bounds_warnings
from teleop.errors import UsageError

SECTIONS = {"master": (MasterConfig, master_gate), "slave": (SlaveConfig, slave_gate)}
LIMITS = [
    (section, field.name, field.metadata["range"])
    for section, (_, gate) in SECTIONS.items()
    for field in fields(gate.GateConfig)
    if "range" in field.metadata and math.isfinite(field.metadata["range"].bound)
]


def test_each_side_has_bounds():
    assert [section for section, *_ in LIMITS] == ["master"] * 4 + ["slave"] * 5


@pytest.mark.parametrize(("section", "name", "limit"), LIMITS)
def test_a_limit_beyond_its_bound_needs_the_explicit_key(section, name, limit):
    cls = SECTIONS[section][0]
    sign = -1 if name.endswith("_min") else 1
    key = f"{section}.gate.{name}"
    load(None, cls, section, [f"{key}={sign * limit.bound}"])
    above = f"{key}={sign * limit.bound * 1.01}"
    with pytest.raises(UsageError, match=rf"{key}.*{limit.bound:g} {limit.unit}") as refused:
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
    for section, name, limit in LIMITS:
        value = (
            f"{limit.bound * 1e3:g} mm" if limit.unit == "m" else f"{limit.bound:g} {limit.unit}"
        )
        assert f"| `{section}.gate.{name}` | {value} |" in text
