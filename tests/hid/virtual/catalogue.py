"""Every virtual device with the report descriptor that belongs to it."""

from collections.abc import Callable

from tests.hid import descriptors
from tests.hid.virtual.arduino import Arduino
from tests.hid.virtual.device import VirtualDevice
from tests.hid.virtual.dualsense import DualSense
from tests.hid.virtual.ffbeast import FFBeast
from tests.hid.virtual.logitech import Logitech
from tests.hid.virtual.openffboard import OpenFFBoard, OpenFFBoardWheel
from tests.hid.virtual.rhino import Rhino
from tests.hid.virtual.sidewinder import SideWinder
from tests.hid.virtual.spacemouse import SpaceMouse

DEVICES: dict[str, Callable[[], VirtualDevice]] = {
    "openffboard": lambda: OpenFFBoard(descriptors.openffboard(2)),
    "openffboard-wheel": lambda: OpenFFBoardWheel(descriptors.openffboard(1)),
    "arduino": lambda: Arduino(descriptors.arduino()),
    "sidewinder": lambda: SideWinder(descriptors.arduino()),
    "rhino": lambda: Rhino(descriptors.rhino()),
    "ffbeast": lambda: FFBeast(descriptors.ffbeast_vendor()),
    "logitech": lambda: Logitech(descriptors.logitech_g29()),
    "dualsense": lambda: DualSense(descriptors.dualsense_usb()),
    "spacemouse": lambda: SpaceMouse(descriptors.spacemouse()),
    "spacemouse-old": lambda: SpaceMouse(descriptors.spacemouse(old=True), older=True),
}
