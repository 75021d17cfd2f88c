"""The virtual firmwares do what is known of the real ones; the drivers are judged by them."""

import struct

import pytest

from tests.hid.virtual.catalogue import DEVICES
from tests.hid.virtual.device import BLUETOOTH
from tests.hid.virtual.dualsense import LEFT, DualSense, zones

# Set Effect of a constant force in block 1: 200 ms, full gain, all that comes from +x
SET_EFFECT = {
    "openffboard": "01 01 01 c8 00 0000 0000 0000 ff 00 04 2823 0000 00000000",
    "openffboard-wheel": "01 01 01 c8 00 0000 0000 0000 ff 00 02 2823 0000",
    "arduino": "01 01 01 c8 00 0000 0000 ff 00 04 40 00 00000000",
    "rhino": "65 01 01 c8 00 0000 0000 0010 00 04 40 00 0000",
}
IDS = {  # creation, block load, constant force, operation, device control, switched on by
    "openffboard": (0x11, 0x12, 5, 0x0A, 0x0C, 0x01),
    "openffboard-wheel": (0x11, 0x12, 5, 0x0A, 0x0C, 0x01),
    "arduino": (5, 6, 5, 0x0A, 0x0C, 1),
    "rhino": (5, 6, 105, 110, 112, 2),
}
FULL = {"openffboard": 32767, "openffboard-wheel": 32767, "arduino": 10000, "rhino": 4096}
PID = sorted(SET_EFFECT)
ALONG = {"openffboard": -1.0, "openffboard-wheel": -1.0, "arduino": 1.0, "rhino": -1.0}


def pushing(name):
    """Return a device that was told at 0 s to push with half of its force."""
    device = DEVICES[name]()
    creation, load, constant, operation, control, on = IDS[name]
    device.output(0.0, bytes((control, on)))
    device.set_feature(0.0, bytes((creation, 1, 0, 0)))
    assert device.get_feature(0.0, load)[:3] == bytes((load, 1, 1))
    device.output(0.0, bytes.fromhex(SET_EFFECT[name]))
    device.output(0.0, struct.pack("<BBh", constant, 1, FULL[name] // 2))
    device.output(0.0, bytes((operation, 1, 1, 1)))
    assert device.refused == []
    return device


@pytest.mark.parametrize("name", PID)
def test_a_force_acts_along_its_axis_until_it_has_run_out(name):
    device = pushing(name)
    assert device.force(0.1)[0] == pytest.approx(0.5 * ALONG[name], abs=0.01)
    assert all(abs(share) < 0.01 for share in device.force(0.1)[1:])
    device.inputs(0.2)
    assert not any(device.force(0.2))
    assert device.pushes[-1].time == 0.2


@pytest.mark.parametrize("name", PID)
def test_a_start_restarts_the_clock_and_a_stop_ends_it(name):
    device, operation = pushing(name), IDS[name][3]
    device.output(0.15, bytes((operation, 1, 1, 1)))
    assert any(device.force(0.34))
    assert not any(device.force(0.36))
    device.output(0.2, bytes((operation, 1, 3, 0)))
    assert not any(device.force(0.2))


@pytest.mark.parametrize("name", PID)
def test_what_is_no_report_of_the_device_is_refused_and_changes_nothing(name):
    device = pushing(name)
    before = device.force(0.1)
    for report in (b"", b"\xff\x01", bytes(30), bytes((IDS[name][2], 1))):
        device.output(0.1, report)
    assert len(device.refused) == 4
    assert device.force(0.1) == before


@pytest.mark.parametrize("name", PID)
def test_the_pool_is_finite(name):
    device = DEVICES[name]()
    creation, load, *_ = IDS[name]
    for block in range(1, device.slots + 1):
        device.set_feature(0.0, bytes((creation, 1, 0, 0)))
        assert device.get_feature(0.0, load)[1:3] == bytes((block, 1))
    device.set_feature(0.0, bytes((creation, 1, 0, 0)))
    assert device.get_feature(0.0, load)[2] == 2


def test_device_control_is_a_mask_or_one_of_two_numberings():
    board, arduino, rhino = pushing("openffboard"), pushing("arduino"), pushing("rhino")
    for device, report in ((board, b"\x0c\x02"), (arduino, b"\x0c\x02"), (rhino, b"\x70\x02")):
        device.output(0.01, report)
    assert not any(board.force(0.02))  # bit 1: disable
    assert any(arduino.force(0.02))  # "disable" does nothing
    assert any(rhino.force(0.02))  # enable
    board.output(0.03, bytes.fromhex(SET_EFFECT["openffboard"]))
    assert any(board.force(0.04))  # Set Effect switches on


def test_quirks_of_the_arduino_library():
    device = pushing("arduino")
    assert device.get_feature(0.0, 6)[1] == 0  # the block was read once already
    both = bytearray.fromhex(SET_EFFECT["arduino"])
    both[11] = 0x07  # axes and direction enabled: then each axis has a direction of its own
    device.output(0.1, bytes(both))
    assert device.force(0.1) == pytest.approx((0.5, -0.5), abs=0.01)
    assert device.get_feature(0.1, 7)
    assert not any(device.force(0.1))  # reading the pool freed all effects


def test_dualsense_over_bluetooth_wants_a_checksum_that_is_right():
    pad = DualSense(b"", BLUETOOTH)
    report = bytearray(78)
    report[0], report[2], report[3] = 0x31, 0x10, 0x08
    report[3 + 21 : 3 + 28] = struct.pack("<BHI", 0x21, 0b1000, 0o7000)
    crc = _crc(b"\xa2" + bytes(report[:74]))
    pad.output(0.0, bytes(report[:74]) + struct.pack("<I", crc ^ 1))
    assert pad.refused
    assert len(pad.pushes) == 1
    pad.output(1.0, bytes(report[:74]) + struct.pack("<I", crc))
    assert pad.pushes[-1] == (1.0, (-1.0, 0.0))
    assert zones(pad.effects[LEFT]) == (0, 0, 0, 8, 0, 0, 0, 0, 0, 0)


def test_spacemouse_is_silent_at_rest_and_says_once_that_it_is_back_there():
    mouse = DEVICES["spacemouse"]()
    assert mouse.inputs(0.0) == []
    mouse.axes[5] = -1.0
    assert mouse.inputs(0.1) == [struct.pack("<B6h", 1, 0, 0, 0, 0, 0, -350)] == mouse.inputs(0.2)
    mouse.axes[5] = 0.0
    assert [len(mouse.inputs(t)) for t in (0.3, 0.4)] == [1, 0]


def _crc(data):
    """CRC-32, bit by bit."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF
