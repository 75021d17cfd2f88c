"""Dump of a HID device, to attach to a report: its numbers and its raw report descriptor, as YAML.

The serial number is left out. The descriptor is in hexadecimal, 16 bytes a line.
"""

import json
import platform
from importlib.metadata import version

from master.device import DeviceFault
from master.devices.hid.search import ExaminedNode

_BYTES_A_LINE = 16


def format_dump(one: ExaminedNode) -> str:
    """Return the dump; `DeviceFault` if the descriptor cannot be read."""
    item, data = one.item, one.descriptor
    if not data:
        raise DeviceFault(f"{item}: {one.not_ready_reason}")
    lines = [
        f"# tendon-teleop {version('tendon-teleop')}, {platform.platform()}",
        f"name: {json.dumps(item.name)}",
        f'vendor: "{item.vendor:04x}"',
        f'product: "{item.product:04x}"',
        f'release: "{item.release:04x}"',
        f"serial_number: {'yes' if item.serial else 'no'}",
        f"bus: {'bluetooth' if item.bluetooth else 'usb'}",
        f"interface: {item.interface}",
        f"usages: {json.dumps([f'{page:04x}:{usage:04x}' for page, usage in item.usages])}",
        "drivers:",
        *(f"  {name}: {json.dumps(why or 'fits')}" for name, why in one.misfits.items()),
        f"bytes: {len(data)}",
        "descriptor: |",
    ]
    lines += [
        f"  {data[start : start + _BYTES_A_LINE].hex(' ')}"
        for start in range(0, len(data), _BYTES_A_LINE)
    ]
    return "\n".join(lines) + "\n"
