"""A device whose force no driver reaches is told what it is, and what to do; nothing is guessed."""

import subprocess
import sys
from types import SimpleNamespace

import pytest

from master.device import DeviceFault
from master.devices.hid import command, search, unsupported
from master.devices.hid.command import OperatorDialogue
from master.devices.hid.device import HidDevice
from master.devices.hid.driver_table import DRIVERS
from master.devices.hid.input_map import AxisConfig, ButtonsConfig, HidConfig
from studies.hid import descriptors
from studies.hid.virtual.catalogue import DEVICES
from studies.hid.virtual.openffboard import OpenFFBoard
from studies.hid.virtual.spacemouse import SpaceMouse
from teleop.cli import commands

HOLD = "import sys; held = open(sys.argv[1]); print(flush=True); sys.stdin.read()"
CONFIG = HidConfig(
    axes=(AxisConfig("x", travel=0.1, force=2.0),), buttons=ButtonsConfig(engage=1), smoothing=0.0
)


def wheel(vendor, product):
    device = DEVICES["logitech"]()
    device.vendor, device.product = vendor, product
    return device


@pytest.mark.parametrize(
    ("vendor", "product", "said"),
    [
        (0x046D, 0xC260, "a G29 with its switch at PS4: set it to PS3, and plug it in again"),
        (0x046D, 0xC261, "a G920 in its mode for an Xbox: `sudo usb_modeswitch -v 046d -p c261 "),
        (0x046D, 0xC272, "(its protocol, HID++, has none yet); run `teleop devices dump 046d:c272"),
        (0x044F, 0xB66E, "(its protocol, Thrustmaster's, has none yet); run `teleop devices dump"),
    ],
)
def test_a_wheel_without_force_here_says_why_in_each_command_and_session(
    hidraw, capsys, vendor, product, said
):
    node = hidraw.plug(wheel(vendor, product))
    assert commands.main(["devices", "list"]) == 0
    assert said in capsys.readouterr().out.splitlines()[-1]
    lines = []
    dialogue = OperatorDialogue(lines.append, lambda _: pytest.fail("asked"))
    command.run_device_test("", "auto", None, 0.02, dialogue)
    assert lines[-1].startswith("It has no force output: ")
    assert said in lines[-1]
    with pytest.raises(DeviceFault) as fault:
        HidDevice(CONFIG, lambda _: None)
    assert said in str(fault.value)
    assert node.written == []


def test_no_wheel_with_a_driver_is_taken_for_one_without():
    models = {(vendor, one) for vendor, some in unsupported.PROTOCOLS.values() for one in some}
    for vendor, product in models | set(unsupported.MODES):
        item = SimpleNamespace(vendor=vendor, product=product, interface=-1, usages=())
        assert DRIVERS["logitech"].misfit(item, b"")


def receiver():
    mouse = SpaceMouse(descriptors.spacemouse())
    mouse.product, mouse.serial, mouse.name = 0xC652, "", "Universal Receiver"
    return mouse


def test_of_two_interfaces_that_fit_alike_none_is_guessed(hidraw):
    first = hidraw.plug(receiver(), ((1, 8),), 0)
    second = hidraw.plug(receiver(), ((1, 8),), 1)
    hidraw.plug(receiver(), ((1, 6),), 2)
    with pytest.raises(DeviceFault) as fault:
        search.find_device("", "auto")
    assert str(fault.value).startswith(
        "2 interfaces of one device fit: look which one reports while you move it (`teleop devices "
        "probe PATH`), then set find to its path: "
    )
    assert str(first.path) in str(fault.value)
    assert search.find_device(str(second.path), "auto").item.interface == 1


def test_another_program_that_has_the_device_open_is_named(hidraw, capsys):
    board = hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    words = ["steam", "-c", HOLD, str(board.path)]
    with subprocess.Popen(words, executable=sys.executable, **pipes) as holder:
        holder.stdout.readline()
        named = f"also open in process {holder.pid} (steam -c import sys"
        commands.main(["devices", "list"])
        assert named in capsys.readouterr().out.splitlines()[-1]
        said = []
        HidDevice(CONFIG, said.append).close()
        assert any(line.startswith("WARNING: ") and named in line for line in said)
        holder.kill()
    said.clear()
    HidDevice(CONFIG, said.append).close()
    assert not any("also open" in line for line in said)
