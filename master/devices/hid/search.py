"""Find attached devices and the drivers that fit them; switch a wheel to its mode for computers."""

import hashlib
import os
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import NamedTuple

from master.device import DeviceFault
from master.devices.hid import unsupported, wheels
from master.devices.hid.descriptor import DescriptorError, parse_descriptor
from master.devices.hid.driver_table import DRIVERS, INPUTS_ONLY, PID, AttachedNode
from master.devices.hid.force_signs import ForceSignKey
from master.devices.hid.node import REMEDY, Node, load_hidapi
from master.devices.hid.pid_layout import has_pid_collection
from teleop.runtime.machine import find_usb_remedy
from teleop.runtime.process import find_openers

# --- what to do about a force-feedback device that no driver can use

_PID_PAGE = b"\x05\x0f"  # the item that selects it, in most descriptors


def format_driver_advice(item: AttachedNode, descriptor: bytes, misfits: Mapping[str, str]) -> str:
    """Return a message with the command that helps; empty if it has no force, or a driver for it.

    Devices with force are those with a PID collection, and wheels known to have another protocol or
    to be in another mode. `misfits` tells by driver why it does not fit; empty if it fits.
    """
    if any(not reason and name != INPUTS_ONLY for name, reason in misfits.items()):
        return ""
    is_first = item.interface <= 0
    mode = unsupported.MODES.get((item.vendor, item.product), "") if is_first else ""
    protocol = unsupported.find_protocol(item.vendor, item.product) if is_first else ""
    if mode:
        return f"no force in this mode: it is {mode}"
    if not (protocol or _has_pid_descriptor(descriptor)):
        return ""
    reason = misfits[PID].removeprefix("by its report descriptor: ")
    if protocol:
        reason = f"its protocol, {protocol}, has none yet"
    return (
        f"it has force feedback, but no driver can use it ({reason}); run `teleop devices dump "
        f"{item.model} --out FILE` and attach FILE to a report"
    )


def _has_pid_descriptor(descriptor: bytes) -> bool:
    try:
        return has_pid_collection(parse_descriptor(descriptor))
    except DescriptorError:
        return _PID_PAGE in descriptor


_SYSTEM = Path("/sys/class/hidraw")  # Linux's world-readable descriptors
_BLUETOOTH = 2  # hidapi's number of that bus


class DeviceNotFoundError(DeviceFault):
    """A device is not attached."""


class FoundDevice(NamedTuple):
    """A device and its driver."""

    item: AttachedNode
    kind: str  # key of `DRIVERS`
    descriptor: bytes

    @property
    def pusher(self) -> ForceSignKey:
        """Its key in the file of force signs."""
        layout = hashlib.sha256(self.descriptor).hexdigest()[:12]
        return ForceSignKey(self.item.identity, self.kind, layout)


class ExaminedNode(NamedTuple):
    """A node examined without opening it."""

    item: AttachedNode
    descriptor: bytes
    misfits: dict[str, str]  # by driver, the reason why it does not fit; empty if it fits
    not_ready_reason: str  # why this user cannot open it, with the remedy; empty if it can

    @property
    def advice(self) -> str:
        """What to do about force feedback that no driver can use; empty if there is none."""
        return format_driver_advice(self.item, self.descriptor, self.misfits)

    @property
    def fits(self) -> list[str]:
        """The drivers that fit, the best first."""
        return [name for name, why_not in self.misfits.items() if not why_not]


def list_attached_nodes() -> tuple[AttachedNode, ...]:
    """Return all HID nodes of this machine, by path; `DeviceFault` without hidapi."""
    nodes: dict[str, AttachedNode] = {}
    for entry in load_hidapi().enumerate():
        path = os.fsdecode(entry["path"])
        usage = (entry.get("usage_page", 0), entry.get("usage", 0))
        node = nodes.get(path)
        if node is not None:  # listed once per outermost collection
            nodes[path] = node._replace(usages=(*node.usages, usage))
            continue
        nodes[path] = AttachedNode(
            path,
            entry["vendor_id"],
            entry["product_id"],
            entry.get("serial_number") or "",
            " ".join(
                part
                for part in (entry.get("manufacturer_string"), entry.get("product_string"))
                if part
            ),
            entry.get("interface_number", -1),
            entry.get("bus_type") == _BLUETOOTH,
            (usage,) if any(usage) else (),
            entry.get("release_number", 0),
        )
    return tuple(nodes[path] for path in sorted(nodes))


def list_node_paths(device: FoundDevice) -> frozenset[str]:
    """Return the paths of other attached nodes that may be devices.

    Called when a device is unplugged, so it only lists names; empty on systems without device
    files.
    """
    folder = os.path.dirname(device.item.path)
    try:
        return frozenset(os.path.join(folder, name) for name in os.listdir(folder))
    except OSError:
        return frozenset()


def read_descriptor(item: AttachedNode) -> bytes:
    """Return a device's report descriptor; `DeviceFault` if it needs a permission."""
    try:
        return (_SYSTEM / Path(item.path).name / "device/report_descriptor").read_bytes()
    except OSError:
        with closing(Node(item.path, str(item))) as node:
            return node.read_descriptor()


def examine_node(item: AttachedNode) -> ExaminedNode:
    """Return which drivers fit a device, and whether it may be opened."""
    try:
        data = read_descriptor(item)
    except DeviceFault as fault:
        reason = str(fault).removeprefix(f"{item}: ")
        return ExaminedNode(item, b"", dict.fromkeys(DRIVERS, reason), reason)
    misfits = {name: kind.misfit(item, data) for name, kind in DRIVERS.items()}
    return ExaminedNode(item, data, misfits, find_access_error(item))


def find_access_error(item: AttachedNode) -> str:
    """Return why this user cannot open a device, with the remedy; empty if it can."""
    path = Path(item.path)
    if path.exists() and not os.access(path, os.R_OK | os.W_OK):
        return f"no permission to open {item.path}; {REMEDY}"
    return ""


def find_other_users(item: AttachedNode) -> str:
    """Return the programs that have a device open, too; empty if none is seen."""
    users = ", ".join(find_openers(item.path))
    return users and f"{item}: also open in {users}: end it if it sends forces or settings (Steam)"


def find_device(find: str, driver: str) -> FoundDevice:
    """Return the device that a config selects.

    `find` is vendor:product, serial number or path; empty means the only one that fits. The driver
    `auto` is the first that fits, generic drivers last. `DeviceFault` if there is none, or more
    than one, or it cannot be opened; with the remedy.
    """
    everything = list_attached_nodes()
    matches = [examine_node(item) for item in everything if is_match(item, find)]
    fitting = _select_interfaces(
        FoundDevice(node.item, name, node.descriptor)
        for node in matches
        for name in node.fits
        if driver in ("auto", name)
    )
    if driver == "auto":
        fitting = [device for device in fitting if device.kind != INPUTS_ONLY] or fitting
    if not fitting:
        raise DeviceFault(_describe_missing_device(find, driver, matches, everything))
    names = _format_node_list(device.item for device in fitting)
    if len(fitting) > 1 and len({device.item.identity for device in fitting}) == 1:
        places = {(device.item.interface, device.kind) for device in fitting}
        if len(places) == len(fitting):
            raise DeviceFault(
                f"{len(fitting)} interfaces of one device fit: look which one reports while you "
                f"move it (`teleop devices probe PATH`), then set find to its path: {names}"
            )
    if len(fitting) > 1:
        raise DeviceFault(f"several devices fit; set find to a serial number or path: {names}")
    reason = find_access_error(fitting[0].item)
    if reason:
        raise DeviceFault(f"{fitting[0].item}: {reason}")
    return fitting[0]


def find_reattached_device(
    device: FoundDevice, paths_before: frozenset[str], claimed_paths: frozenset[str] = frozenset()
) -> FoundDevice:
    """Return the same device at its present path.

    `paths_before` were attached when it was unplugged; a device of the same identity at another of
    these is a different one. `claimed_paths` are in use. `DeviceNotFoundError` if it is not
    attached; `DeviceFault` if there are several of the same identity, or it cannot be opened.
    """
    old_node = device.item
    like = [
        item
        for item in list_attached_nodes()
        if item.is_same_as(old_node) and item.path not in claimed_paths
    ]
    candidates = [
        item for item in like if item.path == old_node.path or item.path not in paths_before
    ]
    if not candidates:
        raise DeviceNotFoundError(f"{old_node}: not attached")
    if len(candidates) > 1:
        raise DeviceFault(
            f"{old_node}: several devices of this identity are attached: "
            f"{_format_node_list(candidates)}"
        )
    reason = find_access_error(candidates[0])
    if reason:
        raise DeviceFault(f"{candidates[0]}: {reason}")
    return device._replace(item=candidates[0])


def is_match(item: AttachedNode, find: str) -> bool:
    """Return whether `find` matches this device."""
    if not find:
        return True
    return find.lower() in (*item.models, item.serial.lower(), item.path.lower())


def _select_interfaces(all_found: Iterable[FoundDevice]) -> list[FoundDevice]:
    """Keep the interfaces of each device that its best driver fits; mostly that is one.

    Nodes of one model and serial number are one device as long as their interfaces differ; the same
    interface twice means two devices.
    """
    best: dict[str, FoundDevice] = {}
    for device in all_found:
        best.setdefault(device.item.path, device)  # the best driver comes first
    groups: dict[str, list[FoundDevice]] = {}
    for device in best.values():
        groups.setdefault(device.item.identity, []).append(device)
    selected: list[FoundDevice] = []
    ranks = list(DRIVERS)
    for group in groups.values():
        one_device = len({device.item.interface for device in group}) == len(group)
        best_kind = min((device.kind for device in group), key=ranks.index)
        selected += [device for device in group if device.kind == best_kind or not one_device]
    return selected


def _describe_missing_device(
    find: str, driver: str, matches: Sequence[ExaminedNode], everything: Sequence[AttachedNode]
) -> str:
    if not everything:
        hint = find_usb_remedy("/dev/hidraw0") or "plug one in (the system lists no HID device)"
        return f"no haptic device attached; {hint}"
    if not matches:
        listed = _format_node_list(everything)
        return f"no device {find!r} attached; plug it in, or correct find (attached: {listed})"
    whys: dict[str, list[AttachedNode]] = {}
    for node in matches:
        reasons = list(node.misfits.values()) if driver == "auto" else [node.misfits[driver]]
        if len(matches) > 1:
            del reasons[1:]  # only the first reason, to keep the line short
        whys.setdefault("; ".join(dict.fromkeys(reasons)), []).append(node.item)
    listed = "; ".join(f"{_format_node_list(items)}: {reason}" for reason, items in whys.items())
    advice = [f"; {node.item}: {node.advice}" for node in matches if node.advice]
    listed += "".join(advice[:1])
    request = "no driver fits" if driver == "auto" else f"driver {driver!r} does not fit"
    return f"{request}: {listed}" if find else f"{request} any attached device: {listed}"


def _format_node_list(items: Iterable[AttachedNode]) -> str:
    return ", ".join(map(str, items))


# --- a wheel that starts as an accessory of a console, switched to the mode for computers
# The G923 for PlayStation has no classic commands in console mode. One report switches it over: it
# detaches and comes back as another product.


MODE_SWITCH_TIMEOUT_S = 10.0  # [s] timeout for the device in its other mode
_POLL_PERIOD_S = 0.1


def leave_console_mode(find: str, driver: str) -> str:
    """Switch the wheel that a config selects; return a message, empty if there was none to switch.

    Only the wheel that is selected by `find`, or is alone: no device beside it has a force driver.

    `DeviceFault` if it cannot be opened, or does not come back.
    """
    everything = list_attached_nodes() if driver in ("auto", "logitech") else ()
    in_console = [node for node in everything if is_in_console_mode(node) and is_match(node, find)]
    if len(in_console) != 1 or (not find and any(map(_has_driver, everything))):
        return ""
    switch_to_pc_mode(in_console[0])
    end = time.monotonic() + MODE_SWITCH_TIMEOUT_S
    while not any(map(_is_in_pc_mode, list_attached_nodes())):
        if time.monotonic() > end:
            raise DeviceFault(
                f"{in_console[0]}: does not leave its console mode; plug it in again, and check "
                "that its switch and its udev rule (docs/how-to/haptic-device.md) are right"
            )
        time.sleep(_POLL_PERIOD_S)
    return f"{in_console[0]}: switched from console to PC mode"


def reattach_device(
    device: FoundDevice, paths_before: frozenset[str], claimed_paths: frozenset[str]
) -> FoundDevice:
    """Return `find_reattached_device`; switch the wheel over if it is in console mode."""
    try:
        return find_reattached_device(device, paths_before, claimed_paths)
    except DeviceNotFoundError:
        old_node = device.item
        if (old_node.vendor, old_node.product) == (wheels.LOGITECH_VENDOR, wheels.G923):
            other_paths = paths_before - {old_node.path} | claimed_paths
            for item in list_attached_nodes():
                if is_in_console_mode(item) and item.path not in other_paths:
                    switch_to_pc_mode(item)
        raise


def is_in_console_mode(item: AttachedNode) -> bool:
    """Return whether this is a wheel to be switched over."""
    return _is_wheel(item, wheels.G923_CONSOLE)


def switch_to_pc_mode(item: AttachedNode) -> None:
    """Send the report; `DeviceFault` if the wheel cannot be opened."""
    if reason := find_access_error(item):
        raise DeviceFault(f"{item}: {reason}")
    with closing(Node(item.path, str(item))) as node, suppress(DeviceFault):
        node.write(wheels.LEAVE_CONSOLE)  # it may detach before it acknowledges


def _has_driver(item: AttachedNode) -> bool:
    return any(name != INPUTS_ONLY for name in examine_node(item).fits)


def _is_in_pc_mode(item: AttachedNode) -> bool:
    return _is_wheel(item, wheels.G923) and not find_access_error(item)


def _is_wheel(item: AttachedNode, product: int) -> bool:
    model = (item.vendor, item.product)
    return model == (wheels.LOGITECH_VENDOR, product) and item.interface <= 0
