"""What Linux does to a PID device at plug-in, before anyone opens it.

The kernel's hid-pidff sits on USB, where a device made by uhid does not; so its writes are played.
OpenFFBoard's were captured on Debian 6.1, which cuts the reset down to no bit at all in a mask. For
the other devices the same steps are written with their numbers; nobody has captured those.
"""

from master.devices.hid.node import Node
from studies.kernel.cases import Case

_CONSTANT = 1


def play(node: Node, case: Case) -> None:
    """Write what hid-pidff writes."""
    known = _WRITES.get(case.name)
    if known is None:
        return
    control, gain, creation, load, pool, free = known
    for report in control:
        node.write(bytes(report))
    node.get_feature(pool, 5)
    node.write(bytes(gain))
    node.send_feature(bytes((creation, _CONSTANT, 0, 0)))
    block = node.get_feature(load, 5)[1]
    node.write(bytes((free, block)))


_BOARD = (((0x0C, 0), (0x0C, 0), (0x0C, 1)), (0x0D, 0xFF), 0x11, 0x12, 0x13, 0x0B)
_WRITES = {
    "openffboard": _BOARD,
    "openffboard-wheel": _BOARD,
    "arduino": (((0x0C, 4), (0x0C, 4), (0x0C, 1)), (0x0D, 0xFF), 0x05, 0x06, 0x07, 0x0B),
    "sidewinder": (((0x0C, 4), (0x0C, 4), (0x0C, 1)), (0x0D, 0xFF), 0x05, 0x06, 0x07, 0x0B),
    "rhino": (((112, 4), (112, 4), (112, 2)), (113, 0xFF), 5, 6, 7, 111),
}
