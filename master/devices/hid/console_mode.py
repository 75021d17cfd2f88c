"""A wheel that starts as an accessory of a console, switched to the mode for computers.

The G923 for PlayStation has no classic commands in console mode. One report switches it over: it
detaches and comes back as another product.
"""

import time
from contextlib import suppress

from master.device import DeviceFault
from master.devices.hid import logitech, search
from master.devices.hid.drivers import INPUTS_ONLY, AttachedNode
from master.devices.hid.node import Node
from master.devices.hid.search import DeviceNotFoundError, FoundDevice

MODE_SWITCH_TIMEOUT_S = 10.0  # [s] timeout for the device in its other mode
_POLL_PERIOD_S = 0.1


def leave_console_mode(find: str, driver: str) -> str:
    """Switch the wheel that a config selects; return a message, empty if there was none to switch.

    Only the wheel that is selected by `find`, or is alone: no device beside it has a force driver.

    Raises
    ------
    DeviceFault
        It cannot be opened, or does not come back.
    """
    everything = search.list_attached_nodes() if driver in ("auto", "logitech") else ()
    wheels = [one for one in everything if is_in_console_mode(one) and search.is_match(one, find)]
    if len(wheels) != 1 or (not find and any(map(_has_driver, everything))):
        return ""
    switch_to_pc_mode(wheels[0])
    end = time.monotonic() + MODE_SWITCH_TIMEOUT_S
    while not any(map(_is_in_pc_mode, search.list_attached_nodes())):
        if time.monotonic() > end:
            raise DeviceFault(
                f"{wheels[0]}: does not leave its console mode; plug it in again, and check that "
                "its switch and its udev rule (docs/devices.md) are right"
            )
        time.sleep(_POLL_PERIOD_S)
    return f"{wheels[0]}: switched from console to PC mode"


def find_reattached_device(
    found: FoundDevice, before: frozenset[str], taken: frozenset[str]
) -> FoundDevice:
    """Return the same device at its present path, as `search.again`; switch it over if needed."""
    try:
        return search.find_reattached_device(found, before, taken)
    except DeviceNotFoundError:
        known = found.item
        if (known.vendor, known.product) == (logitech.VENDOR, logitech.G923):
            others = before - {known.path} | taken
            for item in search.list_attached_nodes():
                if is_in_console_mode(item) and item.path not in others:
                    switch_to_pc_mode(item)
        raise


def is_in_console_mode(item: AttachedNode) -> bool:
    """Return whether this is a wheel to be switched over."""
    model = (item.vendor, item.product)
    return model == (logitech.VENDOR, logitech.G923_CONSOLE) and item.interface <= 0


def switch_to_pc_mode(item: AttachedNode) -> None:
    """Send the report; `DeviceFault` if the wheel cannot be opened."""
    if why := search.find_access_error(item):
        raise DeviceFault(f"{item}: {why}")
    node = Node(item.path, str(item))
    try:
        with suppress(DeviceFault):  # it may detach before it acknowledges
            node.write(logitech.LEAVE_CONSOLE)
    finally:
        node.close()


def _has_driver(item: AttachedNode) -> bool:
    return any(name != INPUTS_ONLY for name in search.examine_node(item).fits)


def _is_in_pc_mode(item: AttachedNode) -> bool:
    model = (item.vendor, item.product)
    is_wheel = model == (logitech.VENDOR, logitech.G923) and item.interface <= 0
    return is_wheel and not search.find_access_error(item)
