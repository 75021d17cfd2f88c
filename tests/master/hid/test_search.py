"""Finding devices, and what is said when there is none that can be used."""

import os

import pytest

from master.device import DeviceFault
from master.devices.hid import search
from master.devices.hid.drivers import DRIVERS, AttachedNode
from tests.hid import descriptors
from tests.hid.virtual.arduino import Arduino
from tests.hid.virtual.device import BLUETOOTH
from tests.hid.virtual.dualsense import DualSense
from tests.hid.virtual.openffboard import OpenFFBoard, OpenFFBoardWheel
from tests.hid.virtual.rhino import Rhino
from tests.hid.virtual.spacemouse import SpaceMouse


class Keyboard:
    """Something that no driver is for."""

    name, bus, vendor, product, serial = "Keyboard", 3, 0x046D, 0xC31C, ""
    descriptor = b"\x05\x01\x09\x06\xa1\x01\xc0"
    interval = 0.01
    pushes: tuple = ()

    def inputs(self, _now):
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
        (OpenFFBoardWheel(descriptors.openffboard(1)), "pid"),
        (Arduino(descriptors.arduino()), "pid"),
        (Rhino(descriptors.rhino()), "pid"),
        (DualSense(descriptors.dualsense_usb()), "dualsense"),
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


def test_two_alike_are_told_apart_by_their_serial_numbers(hidraw):
    for serial in ("A1", "B2"):
        board = OpenFFBoard(descriptors.openffboard())
        board.serial = serial
        hidraw.plug(board)
    with pytest.raises(DeviceFault, match="several"):
        search.find_device("1209:ffb0", "auto")
    assert search.find_device("b2", "auto").item.serial == "B2"


def test_two_of_the_same_serial_number_are_two(hidraw):
    nodes = [hidraw.plug(OpenFFBoard(descriptors.openffboard())) for _ in range(2)]
    with pytest.raises(DeviceFault, match="several"):
        search.find_device("1209:ffb0", "auto")
    assert search.find_device(str(nodes[1].path), "auto").item.path == str(nodes[1].path)


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


def test_a_device_of_several_collections_is_listed_once(hidraw):
    hidraw.plug(Keyboard(), ((1, 6), (12, 1)))
    (item,) = search.list_attached_nodes()
    assert item.usages == ((1, 6), (12, 1))
    assert str(item).startswith("Keyboard (046d:c31c, ")


def test_without_any_the_line_says_what_is_attached(hidraw):
    with pytest.raises(DeviceFault, match=r"no haptic device attached; plug one in.*no HID"):
        search.find_device("", "auto")
    hidraw.plug(Keyboard())
    with pytest.raises(
        DeviceFault, match=r"no driver fits any attached device: Keyboard .*: by its report"
    ):
        search.find_device("", "auto")
    with pytest.raises(DeviceFault, match=r"no device '1209:ffb0' attached.*Keyboard"):
        search.find_device("1209:ffb0", "auto")


def test_a_device_that_no_driver_fits_is_told_why(hidraw):
    hidraw.plug(Keyboard())
    with pytest.raises(DeviceFault, match=r"no driver fits: .*not a DualSense") as refused:
        search.find_device("046d:c31c", "auto")
    assert "\n" not in str(refused.value)
    with pytest.raises(DeviceFault, match=r"'spacemouse' does not fit: .*: not a SpaceMouse$"):
        search.find_device("046d:c31c", "spacemouse")
    with pytest.raises(DeviceFault, match=r"'ffbeast' does not fit any attached device: Key"):
        search.find_device("", "ffbeast")


def test_one_that_may_not_be_opened_names_the_remedy(hidraw, monkeypatch):
    node = hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    monkeypatch.setattr(os, "access", lambda path, _: str(path) != str(node.path))
    with pytest.raises(DeviceFault, match=r"no permission to open .*udev rule"):
        search.find_device("", "auto")


def test_one_that_cannot_even_be_described_is_not_a_crash(hidraw):
    hidraw.plug(OpenFFBoard(descriptors.openffboard())).permitted = False
    for find in ("1209:ffb0", ""):
        with pytest.raises(
            DeviceFault, match=r"no driver fits.*Open_FFB.*cannot be opened; .*udev"
        ):
            search.find_device(find, "auto")


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


def test_the_config_offers_each_driver():
    from typing import get_args, get_type_hints

    from master.devices.hid.mapping import HidConfig

    assert set(get_args(get_type_hints(HidConfig)["driver"])) == {"auto", *DRIVERS}


def test_no_device_that_may_keep_a_force_counts_as_one_that_forgets():
    assert {name for name, kind in DRIVERS.items() if not kind.forgets} == {
        "ffbeast",  # its maker names no time
        "logitech",
        "dualsense",
    }


def test_force_signs_are_of_the_very_device_if_it_has_a_serial_number():
    assert AttachedNode("p", 0x1209, 0xFFB0).identity == "1209:ffb0"
    assert AttachedNode("p", 0x1209, 0xFFB0, "S").identity == "1209:ffb0:S"


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
