"""The checks of a machine, on machines that are not this one."""

import argparse
import os
import tomllib
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

from teleop import doctor
from teleop.doctor import Finding

ROOT = Path(__file__).parents[2]


def test_what_is_needed_is_what_the_project_says():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(doctor.dependencies()) == {line.split(">")[0] for line in project["dependencies"]}
    assert doctor.packages().good


def test_a_missing_package_is_named_with_the_remedy(monkeypatch):
    def version(name):
        if name == "numba":
            raise PackageNotFoundError(name)
        return "1"

    monkeypatch.setattr(doctor, "version", version)
    finding = doctor.packages()
    assert (finding.good, finding.essential) == (False, True)
    assert finding.detail == "missing: numba"
    assert finding.remedy == "pip install numba"


@pytest.mark.parametrize(("count", "good"), [(1, False), (2, True), (None, False)])
def test_two_loops_want_two_processors(monkeypatch, count, good):
    monkeypatch.setattr(os, "cpu_count", lambda: count)
    assert doctor.processors().good == good


def test_real_time_scheduling_is_tried_and_put_back(monkeypatch):
    set_to = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda *words: set_to.append(words[1]))
    assert doctor.real_time().good
    assert set_to == [os.SCHED_FIFO, os.sched_getscheduler(0)]

    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert "rtprio" in doctor.real_time().remedy


@pytest.mark.parametrize(
    ("name", "there"), [("DISPLAY", True), ("WAYLAND_DISPLAY", True), ("X", False)]
)
def test_a_screen_is_found_by_the_environment(monkeypatch, name, there):
    monkeypatch.setattr("sys.platform", "linux")
    for known in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(known, raising=False)
    monkeypatch.setenv(name, ":0")
    assert doctor.screen().good == there


@pytest.mark.parametrize(
    ("findings", "code", "verdict"),
    [
        ([Finding("a", True, "fine")], 0, "Ready"),
        ([Finding("a", True, "fine"), Finding("b", False, "slow", "hurry")], 0, "Ready"),
        ([Finding("a", False, "old", "renew", essential=True)], 1, "Not ready"),
    ],
)
def test_only_what_is_essential_fails(monkeypatch, capsys, findings, code, verdict):
    monkeypatch.setattr(doctor, "CHECKS", [lambda f=f: f for f in findings])
    assert doctor.main(argparse.Namespace()) == code
    *lines, last = capsys.readouterr().out.splitlines()
    assert last.startswith(verdict)
    for finding, line in zip(findings, lines, strict=True):
        assert finding.detail in line
        assert (finding.remedy in line) or finding.good
