"""What to do about a force-feedback device that no driver can use."""

from collections.abc import Mapping

from master.devices.hid import logitech
from master.devices.hid.descriptor import DescriptorError, parse_descriptor
from master.devices.hid.drivers import INPUTS_ONLY, PID, AttachedNode
from master.devices.hid.pid_layout import has_pid_collection

_PID_PAGE = b"\x05\x0f"  # the item that selects it, in most descriptors


def format_driver_advice(item: AttachedNode, descriptor: bytes, misfits: Mapping[str, str]) -> str:
    """Return a message with the command that helps; empty if it has no force, or a driver for it.

    Devices with force are those with a PID collection, and wheels known to have another protocol.

    Parameters
    ----------
    misfits : mapping of str to str
        By driver, why it does not fit; empty if it fits.
    """
    other_protocol = item.vendor == logitech.VENDOR and item.product in logitech.HIDPP_PRODUCTS
    if any(not why and name != INPUTS_ONLY for name, why in misfits.items()):
        return ""
    if not (_has_pid_descriptor(descriptor) or (other_protocol and item.interface <= 0)):
        return ""
    why = misfits[PID].removeprefix("by its report descriptor: ")
    if other_protocol:
        why = "its protocol, HID++, has none yet"
    return (
        f"it has force feedback, but no driver can use it ({why}); run `teleop devices dump "
        f"{item.model} --out FILE` and attach FILE to a report"
    )


def _has_pid_descriptor(descriptor: bytes) -> bool:
    try:
        return has_pid_collection(parse_descriptor(descriptor))
    except DescriptorError:
        return _PID_PAGE in descriptor
