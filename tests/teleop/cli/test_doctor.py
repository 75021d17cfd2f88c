"""The checks of a machine, on machines that are not this one."""

import argparse
import os
import tomllib
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

from slave.drivers import ports
from studies.hid.descriptors import LAYOUTS
from teleop.cli import doctor
from teleop.cli.doctor import Finding
from teleop.errors import TeleopError

ROOT = Path(__file__).parents[3]


def test_what_is_needed_is_what_the_project_says():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(doctor.list_dependencies()) == {
        line.split(">")[0] for line in project["dependencies"]
    }
    assert doctor.check_packages().good


def test_a_missing_package_is_named_with_the_remedy(monkeypatch):
    def version(name):
        if name == "numba":
            raise PackageNotFoundError(name)
        return "1"

    monkeypatch.setattr(doctor, "version", version)
    finding = doctor.check_packages()
    assert (finding.good, finding.essential) == (False, True)
    assert finding.detail == "missing: numba"
    assert finding.remedy == "pip install numba"


def test_real_time_scheduling_is_tried_and_put_back(monkeypatch):
    set_to = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda *words: set_to.append(words[1]))
    assert doctor.check_real_time().good
    assert set_to == [os.SCHED_FIFO, os.sched_getscheduler(0)]

    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert "rtprio" in doctor.check_real_time().remedy
    monkeypatch.setattr(doctor, "find_realtime_remedy", lambda: "as here")
    assert doctor.check_real_time().remedy == "as here"


@pytest.mark.parametrize(
    ("findings", "code", "verdict"),
    [
        ([Finding("a", True, "fine")], 0, "Ready"),
        ([Finding("a", True, "fine"), Finding("b", False, "none", "plug")], 0, "Ready: teleop run"),
        ([Finding("c", False, "slow", "hurry", delays=True)], 0, "Ready, but forces may be late"),
        ([Finding("a", False, "old", "renew", essential=True)], 1, "Not ready"),
    ],
)
def test_only_what_is_essential_fails(monkeypatch, capsys, findings, code, verdict):
    monkeypatch.setattr(doctor, "CHECKS", [lambda f=f: f for f in findings])
    assert doctor.main(argparse.Namespace(startup=False)) == code
    *lines, last = capsys.readouterr().out.splitlines()
    assert last.startswith(verdict)
    for finding, line in zip(findings, lines, strict=True):
        assert finding.detail in line
        assert (finding.remedy in line) or finding.good


@pytest.fixture
def plug(tmp_path, monkeypatch):
    """Plug in a node of a descriptor, one that may not be opened if told so."""
    barred = set()
    monkeypatch.setattr(doctor, "HID_NODES", tmp_path / "dev")
    monkeypatch.setattr(doctor, "HID_DESCRIPTORS", tmp_path / "sys")
    monkeypatch.setattr(os, "access", lambda path, _mode: Path(path).name not in barred)

    def plug(name, descriptor, may=True):
        for folder in (tmp_path / "dev", place := tmp_path / "sys" / name / "device"):
            folder.mkdir(parents=True, exist_ok=True)
        (tmp_path / "dev" / name).touch()
        (place / "report_descriptor").write_bytes(descriptor)
        if not may:
            barred.add(name)

    return plug


@pytest.mark.parametrize("name", ["openffboard 2", "dualsense", "spacemouse"])
def test_a_haptic_device_that_may_not_be_opened_is_a_note_with_the_remedy(plug, name):
    plug("hidraw7", LAYOUTS[name], may=False)
    finding = doctor.check_hid_nodes()
    assert (finding.good, finding.essential) == (False, False)
    assert finding.detail == "1 attached, no permission: hidraw7"
    assert "teleop devices rules" in finding.remedy


def test_a_node_that_was_not_given_to_the_container_is_named_with_the_option(plug, monkeypatch):
    plug("hidraw3", LAYOUTS["openffboard 1"])
    (doctor.HID_NODES / "hidraw3").unlink()
    monkeypatch.setattr(doctor, "find_container", lambda: "")
    assert doctor.check_hid_nodes().good
    monkeypatch.setattr(doctor, "find_container", lambda: "Podman")
    finding = doctor.check_hid_nodes()
    assert (finding.good, finding.detail) == (False, "not in this container: hidraw3")
    assert finding.remedy == "docker run --device /dev/hidraw3 ..."
    (doctor.HID_NODES / "hidraw3").touch()
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert doctor.check_hid_nodes().remedy.startswith("on the machine outside, where udev runs: ")


def test_serial_adapters_are_told_with_what_keeps_them_from_being_used(tmp_path, monkeypatch):
    monkeypatch.setattr(ports, "DEVICES", tmp_path)
    monkeypatch.setattr(ports, "TTYS", tmp_path / "tty")
    assert doctor.check_serial_ports().good
    assert doctor.check_serial_ports().detail.startswith("none attached")
    (tmp_path / "ttyUSB0").touch()
    assert doctor.check_serial_ports() == Finding("serial ports", True, "1 attached")
    timer = tmp_path / "tty/ttyUSB0/device/latency_timer"
    timer.parent.mkdir(parents=True)
    timer.write_text("16\n")
    finding = doctor.check_serial_ports()
    assert not finding.good
    assert f"{tmp_path}/ttyUSB0: the adapter's latency timer is 16 ms: echo 1" in finding.detail


def test_folders_that_cannot_be_written_are_named_with_their_variables(monkeypatch):
    assert doctor.check_folders().good
    monkeypatch.setattr(doctor, "choose_folder", lambda: None)
    monkeypatch.setenv("XDG_STATE_HOME", "/proc/none")
    monkeypatch.setenv("XDG_CONFIG_HOME", "relative")
    monkeypatch.setattr(os, "access", lambda path, _mode: path != Path("/proc"))
    finding = doctor.check_folders()
    assert not finding.good
    assert finding.essential
    assert finding.detail.startswith(
        "/proc cannot be written (XDG_STATE_HOME); no folder of this user (XDG_CONFIG_HOME); "
    )
    assert finding.detail.endswith("compiled code is not kept (NUMBA_CACHE_DIR)")

    def refuse():
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr(doctor, "choose_folder", refuse)
    assert "compiled code is not kept" in doctor.check_folders().detail
    monkeypatch.delenv("XDG_STATE_HOME")
    assert not doctor.check_folders().essential
    monkeypatch.setattr(doctor, "find_container", lambda: "Docker")
    assert "docker run --tmpfs /tmp" in doctor.check_folders().remedy


def test_a_clock_before_the_installation_is_a_note(monkeypatch):
    assert doctor.check_clock().good
    days_off = doctor.INSTALLED.stat().st_mtime - 5 * 86_400.0
    monkeypatch.setattr("time.time", lambda: days_off)
    finding = doctor.check_clock()
    assert (finding.good, finding.essential) == (False, False)
    assert "before this program was installed" in finding.detail
    assert finding.remedy.startswith("sudo timedatectl set-ntp true")


def test_keyboards_and_mice_do_not_matter(plug):
    plug("hidraw0", b"\x05\x01\x09\x06\xa1\x01\xc0", may=False)
    plug("hidraw1", b"\x05\x01\x09\x02\xa1\x01\xc0", may=False)
    assert doctor.check_hid_nodes().detail.startswith("none attached")
    plug("hidraw2", LAYOUTS["openffboard 1"])
    assert (doctor.check_hid_nodes().good, doctor.check_hid_nodes().detail) == (True, "1 attached")


def test_the_parts_of_a_start_are_its_time():
    _, total_s, imports = doctor.measure_startup("master")
    assert {"numba", "master", "teleop"} <= set(imports)
    assert "slave" not in imports  # a side does not load the other
    assert 0.0 < imports.total() * 1e-6 < total_s
    head, *rows = doctor.format_startup("master", 31.0, total_s, imports)
    assert f"{total_s:.2f} s" in head
    assert "31.0 s" in head
    assert sum(float(row.split()[0]) for row in rows) == pytest.approx(total_s, abs=0.05 * 2)


def test_a_side_that_does_not_start_is_one_line():
    with pytest.raises(TeleopError, match=r"^teleop nobody did not start: teleop: .*nobody"):
        doctor.measure_startup("nobody")
