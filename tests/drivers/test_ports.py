"""Serial ports: the adapter meant is the one that is moved, and who keeps us off is named."""

import errno
import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from slave.drivers import claim, driver_table, ports
from slave.drivers.cia402 import bus
from slave.drivers.cia402.config import BusConfig, Cia402Config
from slave.drivers.driver import Channels, DriverFault
from slave.drivers.dynamixel.config import DynamixelConfig
from slave.drivers.microcontroller.config import MicrocontrollerConfig
from slave.drivers.serial_port import format_port_error
from teleop.cli import commands

HOLD = "import sys; held = open(sys.argv[1]); print(flush=True); sys.stdin.read()"
MOTORS = Channels((1,), (1,))


@pytest.fixture
def plug(tmp_path, monkeypatch):
    """Plug in an adapter; return its device file."""
    monkeypatch.setattr(ports, "DEVICES", tmp_path / "dev")
    monkeypatch.setattr(ports, "TTYS", tmp_path / "tty")
    monkeypatch.setattr(ports, "NETWORK", tmp_path / "net")

    def plug(device, by_id="", by_path="", latency_ms=1, product="6014"):
        file = tmp_path / "dev" / device
        for kind, name in (("by-id", by_id), ("by-path", by_path)):
            folder = tmp_path / "dev/serial" / kind
            folder.mkdir(parents=True, exist_ok=True)
            if name:
                (folder / name).unlink(missing_ok=True)
                (folder / name).symlink_to(file)
        usb = tmp_path / "usb" / device
        (usb / "tty").mkdir(parents=True)
        (usb / "idVendor").write_text("0403\n")
        (usb / "idProduct").write_text(f"{product}\n")
        (usb / "tty/latency_timer").write_text(f"{latency_ms}\n")
        (tmp_path / "tty" / device).mkdir(parents=True)
        (tmp_path / "tty" / device / "device").symlink_to(usb / "tty")
        file.touch()
        return str(file)

    return plug


@pytest.mark.parametrize(
    "config",
    [
        lambda port: DynamixelConfig(port=port),
        lambda port: MicrocontrollerConfig(port=port),
        lambda port: Cia402Config(bus=BusConfig(interface="slcan", channel=port)),
    ],
)
def test_motors_are_moved_only_by_a_name_that_stays_with_the_adapter(plug, tmp_path, config):
    left, right = plug("ttyUSB0", "usb-A", "pci-1"), plug("ttyUSB1", "usb-B", "pci-2")
    serial = tmp_path / "dev/serial"
    for port, lasting in ((left, "usb-A"), (right, "usb-B")):
        with pytest.raises(
            DriverFault, match=f"nothing is moved: set it to {serial}/by-id/{lasting}$"
        ):
            driver_table.open_driver(config(port), MOTORS)
        driver_table.open_driver(config(port), Channels((1,), (1,), read_only=True))
        driver_table.open_driver(config(port), Channels((), (1,)))
    (tmp_path / "my-arm").symlink_to(left)  # by a rule of the user's
    for name in (serial / "by-id/usb-A", serial / "by-path/pci-2", tmp_path / "my-arm", "can0"):
        driver_table.open_driver(config(str(name)), MOTORS)


def test_adapters_without_serial_numbers_are_told_apart_by_their_sockets(plug, tmp_path):
    plug("ttyUSB0", "usb-CH340", "pci-1")
    plug("ttyUSB1", "usb-CH340", "pci-2")  # takes the name of the first
    serial = tmp_path / "dev/serial"
    with pytest.raises(DriverFault, match=f"set it to {serial}/by-path/pci-2$"):
        ports.require_lasting_name(str(serial / "by-id/usb-CH340"))
    with pytest.raises(DriverFault, match=f"set it to {serial}/by-path/pci-1$"):
        ports.require_lasting_name(str(tmp_path / "dev/ttyUSB0"))
    ports.require_lasting_name(str(serial / "by-path/pci-1"))
    plug("ttyUSB2", "usb-FTDI-A1", "pci-3", product="6015")  # of another model, with its number
    ports.require_lasting_name(str(serial / "by-id/usb-FTDI-A1"))


def test_without_udev_the_device_file_is_listed_and_used(plug):
    port = plug("ttyACM0")  # docker run --device
    ports.require_lasting_name(port)
    assert list(ports.describe_interfaces()) == [port]


def test_a_scan_lists_each_port_with_what_keeps_it_from_being_used(plug, monkeypatch, capsys):
    slow, barred = plug("ttyUSB0", "usb-A", latency_ms=16), plug("ttyUSB1", "usb-B")
    monkeypatch.setattr(os, "access", lambda path, _mode: path != barred)
    assert commands.main(["rig", "scan"]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert f"/by-id/usb-A -> {slow}; the adapter's latency timer is 16 ms: echo 1 | " in first
    assert f"/by-id/usb-B -> {barred}; no permission" in second


@pytest.mark.parametrize(
    ("group", "members", "mode", "container", "said"),
    [
        ("uucp", [], 0o660, "", "no permission: sudo usermod -aG uucp $USER, then log in again"),
        (
            "dialout",
            ["me"],
            0o600,
            "",
            'SUBSYSTEM=="tty", ATTRS{idVendor}=="0403", GROUP="dialout"',
        ),
        ("dialout", [], 0o660, "Docker", "no permission: docker run --group-add 18 ..."),
    ],
)
def test_who_may_not_open_a_port_is_told_what_gives_the_right(
    plug, monkeypatch, group, members, mode, container, said
):
    port = plug("ttyUSB0", "usb-A")
    status = os.stat_result((mode, 1, 1, 1, 0, 18, 0, 0, 0, 0))
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(os, "stat", lambda *_args, **_: status)
    monkeypatch.setattr("grp.getgrgid", lambda _gid: (group, "x", 18, members))
    monkeypatch.setattr("pwd.getpwuid", lambda _uid: SimpleNamespace(pw_name="me"))
    monkeypatch.setattr(ports, "find_container", lambda: container)
    assert said in ports.explain_denied(port)
    denied = OSError(errno.EACCES, "Permission denied")
    assert said in format_port_error(denied, port)
    assert said in str(bus.to_driver_fault(Cia402Config(bus=BusConfig("slcan", port)), denied))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("ModemManager", 'ATTRS{idVendor}=="0403", ENV{ID_MM_DEVICE_IGNORE}="1"'),
        ("brltty", "sudo ln -s /dev/null /etc/udev/rules.d/85-brltty.rules"),
    ],
)
def test_a_program_that_has_not_locked_a_port_is_named_with_what_ends_that(
    plug, tmp_path, name, said
):
    port = plug("ttyUSB0", "usb-A")
    program = tmp_path / name
    program.symlink_to(sys.executable)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([name, "-c", HOLD, port], executable=program, **pipes) as holder:
        holder.stdout.readline()
        with pytest.raises(DriverFault) as fault:
            claim.claim_port(port)
        assert next(ports.describe_interfaces()).count("in use by process") == 1
        holder.kill()
    assert f"{port}: in use by process {holder.pid} ({name} -c import sys" in str(fault.value)
    assert said in str(fault.value)
    claim.claim_port(port).close()  # what was refused holds nothing
