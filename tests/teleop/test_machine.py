"""Where a program runs, and whether a window can be opened there."""

import os
import platform
import socket

import pytest

from teleop.cli import doctor
from teleop.runtime import machine
from teleop.runtime.process import has_display


@pytest.fixture(autouse=True)
def bare(monkeypatch, tmp_path):
    """A machine that is no container and has no display."""
    for name in ("container", "KUBERNETES_SERVICE_HOST", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(machine, "ROOT", tmp_path)
    monkeypatch.setattr(platform, "release", lambda: "6.1.0-18-amd64")


def test_on_a_machine_itself_rights_are_given_at_login():
    assert machine.describe_machine() == "Linux 6.1.0-18-amd64"
    assert "/etc/security/limits.conf" in machine.find_realtime_remedy()


@pytest.mark.parametrize(
    ("name", "kind"), [(".dockerenv", "Docker"), ("run/.containerenv", "Podman")]
)
def test_a_container_is_known_by_its_file_and_gets_its_rights_when_it_is_started(
    tmp_path, name, kind
):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).touch()
    assert machine.describe_machine() == f"Linux 6.1.0-18-amd64, in a container ({kind})"
    remedy = machine.find_realtime_remedy()
    assert "--cap-add=sys_nice --ulimit rtprio=99 --ulimit memlock=-1" in remedy


def test_kubernetes_and_wsl_have_remedies_of_their_own(monkeypatch):
    monkeypatch.setattr(platform, "release", lambda: "5.15.153.1-microsoft-standard-WSL2")
    assert machine.describe_machine().endswith("WSL2, in WSL")
    assert "sudo prlimit --pid $$ --rtprio=50" in machine.find_realtime_remedy()
    monkeypatch.setenv("KUBERNETES_SERVICE_HOST", "10.0.0.1")
    assert "add: [SYS_NICE, IPC_LOCK]" in machine.find_realtime_remedy()
    monkeypatch.delenv("KUBERNETES_SERVICE_HOST")
    monkeypatch.setenv("container", "lxc")
    assert machine.describe_machine().endswith("in a container (Lxc)")


def test_a_display_is_one_that_answers_here(monkeypatch):
    assert machine.find_display_problem() == "none"
    monkeypatch.setenv("DISPLAY", ":7719")
    assert machine.find_display_problem() == ":7719 is set, but no display answers there"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("\0/tmp/.X11-unix/X7719")
        server.listen()
        for display in (":7719", ":7719.0", "unix:7719"):
            monkeypatch.setenv("DISPLAY", display)
            assert has_display()
    assert not has_display()


@pytest.mark.parametrize("display", ["localhost:10.0", "192.168.1.5:0", "host.docker.internal:0"])
def test_a_window_of_another_machine_is_left_to_its_browser(monkeypatch, display):
    monkeypatch.setenv("DISPLAY", display)
    assert not has_display()
    assert machine.find_display_problem() == (
        f"{display} is of another machine (ssh -X), without its graphics card"
    )


def test_wayland_needs_its_socket_and_wsl_a_graphics_card(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert not has_display()
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "wayland-0"))
        assert has_display()
        monkeypatch.setattr(platform, "release", lambda: "5.15.153.1-microsoft-standard-WSL2")
        assert machine.find_display_problem() == "WSL without a graphics card (/dev/dxg)"
        (tmp_path / "dev").mkdir()
        (tmp_path / "dev/dxg").touch()
        assert has_display()


@pytest.mark.parametrize(("quota", "count"), [("150000 100000", 1), ("max 100000", 8), ("", 8)])
def test_processors_are_counted_as_a_container_may_use_them(monkeypatch, tmp_path, quota, count):
    monkeypatch.setattr(machine, "CPU_QUOTA", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _process: range(8))
    (tmp_path / "cpu.max").write_text(quota)
    assert machine.count_processors() == count
    assert doctor.check_processors().detail == str(count)
