"""Finding devices, what is said when none can be used, and a wheel in console mode."""

import os

import pytest

from master.device import DeviceFault
from master.devices.hid import driver_table, dualsense, joystick, search, wheels
from master.devices.hid.device import HidDevice
from master.devices.hid.input_map import AxisConfig, HidConfig
from studies.hid import descriptors
from studies.hid.virtual.arduino import Arduino
from studies.hid.virtual.device import BLUETOOTH
from studies.hid.virtual.dualsense import DualSense
from studies.hid.virtual.logitech import Logitech
from studies.hid.virtual.openffboard import OpenFFBoard, OpenFFBoardWheel
from studies.hid.virtual.rhino import Rhino
from studies.hid.virtual.spacemouse import SpaceMouse
from studies.testbed.processes import wait_for_condition
from tests.master.reading import comes_back, reads


class Keyboard:
    name, bus, vendor, product, serial = "Keyboard", 3, 0x046D, 0xC31C, ""
    descriptor = b"\x05\x01\x09\x06\xa1\x01\xc0"
    interval = 0.01
    pushes: tuple = ()

    def build_inputs(self, _now):
        return []


def ffbeast(interface):
    class Wheel(Keyboard):
        name, vendor, product, serial = "FFBeast", 0x045B, 0x59D7, "W1"
        descriptor = descriptors.ffbeast_pid() if interface else descriptors.ffbeast_vendor()

    return Wheel()


@pytest.mark.parametrize(
    ("device", "kind"),
    [
        (OpenFFBoard(descriptors.openffboard()), "pid"),
        (Rhino(descriptors.rhino()), "pid"),
        (DualSense(descriptors.dualsense_usb(), BLUETOOTH), "dualsense"),
        (SpaceMouse(descriptors.spacemouse()), "spacemouse"),
    ],
)
def test_the_only_device_that_fits_is_found_among_others(hidraw, device, kind):
    hidraw.plug(Keyboard(), ((1, 6),))
    usage = (1, 8) if kind == "spacemouse" else (1, 4)
    node = hidraw.plug(device, (usage,))
    found = search.find_device("", "auto")
    assert (found.item.path, found.kind) == (str(node.path), kind)
    assert found.item.bluetooth == (device.bus == BLUETOOTH)
    model = f"{device.vendor:04x}:{device.product:04x}"
    for find in (model, model.upper(), device.serial, str(node.path)):
        assert search.find_device(find, "auto") == found


def pedal():
    class Pedal(Keyboard):
        name, vendor, product = "Pedal", 0x05F3, 0x00FF
        descriptor = descriptors.logitech_g29()

    return Pedal()


def test_a_joystick_is_taken_only_if_there_is_nothing_better(hidraw):
    hidraw.plug(pedal(), ((1, 4),))
    found = search.find_device("", "auto")
    assert (found.item.name, found.kind) == ("Pedal", "joystick")
    hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    assert search.find_device("", "auto").kind == "pid"
    assert search.find_device("05f3:00ff", "auto") == found
    assert search.find_device("1209:ffb0", "joystick").kind == "joystick"


def test_of_two_the_config_must_name_one(hidraw):
    hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    hidraw.plug(Arduino(descriptors.arduino()))
    with pytest.raises(DeviceFault, match=r"several devices fit.*1209:ffb0.*2341:8036"):
        search.find_device("", "auto")
    assert search.find_device("2341:8036", "auto").item.name == "Arduino LLC Arduino Leonardo"


@pytest.mark.parametrize("serial", ["W1", ""])
def test_a_wheel_of_two_interfaces_is_one_device_and_its_driver_can_be_named(hidraw, serial):
    for _ in range(2):
        for interface, usage in ((0, (0xFF00, 1)), (1, (1, 4))):
            wheel = ffbeast(interface)
            wheel.serial = serial
            hidraw.plug(wheel, (usage,), interface)
        if len(hidraw.nodes) == 2:
            assert search.find_device("", "auto").kind == "pid"  # it has buttons, the other has not
            assert search.find_device("", "ffbeast").item.usages == ((0xFF00, 1),)
    with pytest.raises(DeviceFault, match="several"):  # two wheels
        search.find_device("", "auto")
    with pytest.raises(DeviceFault, match="several"):
        search.find_device("", "ffbeast")


def test_one_that_may_not_be_opened_names_the_remedy(hidraw, monkeypatch):
    node = hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    monkeypatch.setattr(os, "access", lambda path, _: str(path) != str(node.path))
    with pytest.raises(DeviceFault, match=r"no permission to open .*; teleop devices rules"):
        search.find_device("", "auto")


def test_the_descriptor_is_read_where_linux_shows_it_to_all(hidraw, tmp_path, monkeypatch):
    node = hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    node.permitted = False
    place = tmp_path / node.path.name / "device"
    place.mkdir(parents=True)
    (place / "report_descriptor").write_bytes(descriptors.openffboard())
    monkeypatch.setattr(search, "_SYSTEM", tmp_path)
    assert search.find_device("", "auto").kind == "pid"


def test_the_same_device_is_found_again_under_another_path(hidraw):
    node = hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    found = search.find_device("", "auto")
    hidraw.unplug(node)
    none = frozenset[str]()
    with pytest.raises(search.DeviceNotFoundError):
        search.find_reattached_device(found, none)
    other = OpenFFBoard(descriptors.openffboard())
    other.serial = "another"
    hidraw.plug(other)
    with pytest.raises(search.DeviceNotFoundError):
        search.find_reattached_device(found, none)
    back = hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    assert search.find_reattached_device(found, none).item.path == str(back.path) != found.item.path
    hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    with pytest.raises(DeviceFault, match="several devices of this identity"):
        search.find_reattached_device(found, none)


def test_what_was_beside_it_when_it_went_is_not_it_but_it_may_never_have_left(hidraw):
    node = hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    found = search.find_device("", "auto")
    hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    before = search.list_node_paths(found)
    assert search.find_reattached_device(found, before) == found
    hidraw.unplug(node)
    with pytest.raises(search.DeviceNotFoundError):
        search.find_reattached_device(found, before)
    back = hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    assert search.find_reattached_device(found, before).item.path == str(back.path)


def test_force_signs_are_of_one_driver_and_one_descriptor(hidraw):
    hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    pid, joystick = (search.find_device("", name).pusher for name in ("pid", "joystick"))
    assert (pid.device, pid.driver) == (f"1209:ffb0:{OpenFFBoard.serial}", "pid")
    assert pid != joystick == pid._replace(driver="joystick")
    hidraw.nodes.clear()
    hidraw.plug(OpenFFBoardWheel(descriptors.openffboard(1)))
    other = search.find_device("", "pid")
    assert (
        other._replace(item=other.item._replace(serial=OpenFFBoard.serial)).pusher.layout
        != pid.layout
    )


def test_there_is_a_rule_for_every_model_that_a_driver_is_for():
    text = driver_table.format_rules()
    models = [(wheels.LOGITECH_VENDOR, product) for product in wheels.LOGITECH_PRODUCTS]
    models += [
        (joystick.SPACEMOUSE_OLD_VENDOR, product) for product in joystick.SPACEMOUSE_OLD_PRODUCTS
    ]
    models += [(dualsense.VENDOR, product) for product in dualsense.PRODUCTS]
    for vendor, product in (*models, (wheels.FFBEAST_VENDOR, wheels.FFBEAST_PRODUCT)):
        assert f'{{idVendor}}=="{vendor:04x}", ATTRS{{idProduct}}=="{product:04x}"' in text


def test_one_more_device_is_added_and_a_known_one_is_not_said_twice():
    text = driver_table.format_rules(
        [(0x1234, 0xABCD, "Mine\nRUN+=evil"), (0x1209, 0xFFB0, "again")]
    )
    assert 'ATTRS{idVendor}=="1234", ATTRS{idProduct}=="abcd"' in text
    assert "# Mine RUN+=evil\n" in text
    assert text.count('"ffb0"') == 1
    assert not any(line.startswith("RUN") for line in text.splitlines())


SWITCH = bytes.fromhex("30 f8 09 07 01 01 00 00")  # berarma/new-lg4ff: report 30, then 7 bytes
CENTRE_OFF = bytes.fromhex("00 f5 00 00 00 00 00 00")
STOP = bytes.fromhex("00 13 00 00 00 00 00 00")


class Wheel(Logitech):
    """A G923 in PC mode."""

    name, product = "Logitech G923 Racing Wheel", 0xC266


class ConsoleWheel(Logitech):
    """A G923 in console mode, which takes one report and is then another device."""

    name, product = "Logitech G923 Racing Wheel", 0xC267

    def __init__(self, bus, leaves=True):
        super().__init__(descriptors.logitech_g29())
        self.bus, self.leaves, self.now = bus, leaves, None

    def take_output(self, _now, report):
        if report != SWITCH:
            self.refused.append(report)
        elif self.leaves:
            node = next(node for node in self.bus.nodes.values() if node.device is self)
            self.bus.unplug(node)
            self.now = self.bus.plug(wheel())


def wheel():
    device = Wheel(descriptors.logitech_g29())
    device.interval = 0.010
    return device


def config(find=""):
    return HidConfig(find=find, axes=(AxisConfig("x", travel=0.1, force=2.0),), smoothing=0.0)


@pytest.mark.parametrize("find", ["", "046d:c266"])
def test_it_is_switched_over_with_the_one_report_and_driven_by_classic_commands(hidraw, find):
    before = ConsoleWheel(hidraw)
    node, said = hidraw.plug(before), []
    device = HidDevice(config(find), said.append)
    assert node.written == [SWITCH]
    assert before.now.written[:2] == [CENTRE_OFF, STOP]
    assert "switched from console to PC mode" in said[0]
    assert comes_back(device)
    device.close()
    assert before.now.device.refused == []


def test_back_in_console_mode_after_a_replug_it_is_switched_over_again(hidraw):
    node = hidraw.plug(wheel())
    device = HidDevice(config(), lambda _line: None)
    hidraw.unplug(node)
    assert not reads(device)
    back = ConsoleWheel(hidraw)
    hidraw.plug(back)
    assert comes_back(device)
    assert CENTRE_OFF in back.now.written
    device.close()


def test_another_one_in_console_mode_is_left_alone_by_a_replug(hidraw):
    node, other = hidraw.plug(wheel()), hidraw.plug(ConsoleWheel(hidraw))
    device = HidDevice(config(str(node.path)), lambda _line: None)
    hidraw.unplug(node)
    assert not reads(device)
    assert not wait_for_condition(lambda: other.written or reads(device), 0.5)
    device.close()


def test_beside_another_device_it_must_be_selected(hidraw):
    node = hidraw.plug(ConsoleWheel(hidraw))
    hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    assert search.leave_console_mode("", "auto") == ""
    assert search.leave_console_mode("1209:ffb0", "auto") == ""
    assert search.leave_console_mode("046d:c267", "joystick") == ""
    assert node.written == []
    assert search.find_device("", "auto").kind == "pid"
    assert search.leave_console_mode("046d:c267", "auto")
    assert node.written == [SWITCH]


def test_one_that_stays_in_console_mode_is_said(hidraw, monkeypatch):
    monkeypatch.setattr(search, "MODE_SWITCH_TIMEOUT_S", 0.1)
    hidraw.plug(ConsoleWheel(hidraw, leaves=False))
    with pytest.raises(DeviceFault, match="does not leave its console mode"):
        HidDevice(config(), lambda _line: None)
