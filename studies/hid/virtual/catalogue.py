"""Every virtual device with the report descriptor that belongs to it."""

from collections.abc import Callable

from studies.hid import descriptors
from studies.hid.virtual.arduino import Arduino
from studies.hid.virtual.device import VirtualDevice
from studies.hid.virtual.dualsense import DualSense
from studies.hid.virtual.ffbeast import FFBeast
from studies.hid.virtual.logitech import Logitech
from studies.hid.virtual.openffboard import OpenFFBoard, OpenFFBoardWheel
from studies.hid.virtual.rhino import Rhino
from studies.hid.virtual.sidewinder import SideWinder
from studies.hid.virtual.spacemouse import SpaceMouse

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
