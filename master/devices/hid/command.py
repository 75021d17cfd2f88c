"""List, probe, dump and test haptic devices; print the udev rules that open them.

  teleop devices list                 list attached devices, drivers and permissions
  teleop devices probe 1209:ffb0      print its report descriptor and report rate
  teleop devices dump 1209:ffb0       print its raw report descriptor, to attach to a report
  teleop devices test                 test axes and buttons, find the sign of the force
  teleop devices rules | sudo tee /etc/udev/rules.d/70-tendon-teleop.rules

A device is given like `find` in a config: vendor:product, serial number or path; by default the
only one that fits. An axis without a sign from `test` renders no force.
"""

import argparse
import itertools
import json
import math
import platform
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from master.device import DeviceFault
from master.devices.hid import driver_table, force_signs, search, unsupported
from master.devices.hid.connection import DeviceConnection
from master.devices.hid.descriptor import DescriptorError, parse_descriptor
from master.devices.hid.driver import Controls
from master.devices.hid.driver_table import DRIVERS, AttachedNode
from master.devices.hid.force_signs import ForceSign
from master.devices.hid.node import Node
from master.devices.hid.pid import PidConfig
from master.devices.hid.search import ExaminedNode, FoundDevice
from master.devices.hid.usages import describe_descriptor
from teleop.errors import UsageError
from teleop.runtime.machine import find_usb_remedy
from teleop.runtime.output_file import OutputFile, UpdatedFile
from teleop.runtime.process import parse_seconds, write_text_file
from teleop.runtime.status_line import StatusLine

# --- dump of a HID device, to attach to a report: its numbers and its raw report descriptor, as
# YAML
# The serial number is left out. The descriptor is in hexadecimal, 16 bytes a line.


_BYTES_A_LINE = 16


def format_dump(node: ExaminedNode) -> str:
    """Return the dump; `DeviceFault` if the descriptor cannot be read."""
    item, data = node.item, node.descriptor
    if not data:
        raise DeviceFault(f"{item}: {node.not_ready_reason}")
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
        *(f"  {name}: {json.dumps(misfit or 'fits')}" for name, misfit in node.misfits.items()),
        f"bytes: {len(data)}",
        "descriptor: |",
    ]
    lines += [
        f"  {data[start : start + _BYTES_A_LINE].hex(' ')}"
        for start in range(0, len(data), _BYTES_A_LINE)
    ]
    return "\n".join(lines) + "\n"


PROBE_S, TEST_S = 2.0, 10.0  # [s] default durations
_POLL_PERIOD_S = 0.005  # [s] between two looks at a device
_ANSWERS = {"l": 1, "s": -1, "n": 0}


class OperatorDialogue(NamedTuple):
    """Console dialogue with the person at the device."""

    write: Callable[[str], None] = print
    prompt: Callable[[str], str] = input


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands of `teleop devices`."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    actions.add_parser("list", help="list attached devices, drivers and permissions")
    probe = actions.add_parser("probe", help="print the report descriptor and the report rate")
    raw = actions.add_parser("dump", help="print the raw report descriptor, for a report")
    test = actions.add_parser("test", help="test axes and buttons, find the sign of the force")
    actions.add_parser("rules", help="print udev rules that let you open haptic devices (Linux)")
    for action, purpose, duration in (
        (probe, "count reports", PROBE_S),
        (test, "watch the inputs", TEST_S),
    ):
        _add_device_argument(action)
        action.add_argument(
            "--seconds",
            type=parse_seconds,
            metavar="S",
            default=None,
            help=f"seconds to {purpose} (default {duration:g})",
        )
    _add_device_argument(raw)
    raw.add_argument("--out", type=OutputFile(), metavar="FILE", help="write it to a file")
    test.add_argument(
        "--driver", choices=("auto", *DRIVERS), default="auto", help="driver to use (default auto)"
    )
    test.add_argument(
        "--signs",
        type=UpdatedFile(),
        metavar="FILE",
        help="file of force signs (default ~/.config/tendon-teleop/force-signs.yaml; "
        "XDG_CONFIG_HOME replaces ~/.config)",
    )


def _add_device_argument(action: argparse.ArgumentParser) -> None:
    action.add_argument(
        "find",
        nargs="?",
        default="",
        metavar="DEVICE",
        help="vendor:product, serial number or path (default the only one that fits)",
    )


def main(args: argparse.Namespace) -> int:
    """Run the subcommand; returns the exit code."""
    try:
        if args.action == "list":
            print("\n".join(format_nodes(search.list_attached_nodes())))
        elif args.action == "rules":
            print(
                driver_table.format_rules(list_fitting_devices(search.list_attached_nodes())),
                end="",
            )
        elif args.action == "probe":
            print("\n".join(probe_device(select_device(args.find), args.seconds or PROBE_S)))
        elif args.action == "dump":
            save_dump(select_devices(args.find), args.out)
        else:
            run_device_test(
                args.find, args.driver, args.signs, args.seconds or TEST_S, OperatorDialogue()
            )
    except DeviceFault as fault:
        raise UsageError(str(fault)) from fault
    return 0


def format_nodes(items: Sequence[AttachedNode]) -> list[str]:
    """Return a table of the attached devices, and what to do about some."""
    arms = [f"{arm.model}: {arm.advice}" for arm in unsupported.list_usb_arms()]
    if not items:
        hint = find_usb_remedy("/dev/hidraw0")
        return [f"no HID device attached{'; ' * bool(hint)}{hint}", *arms]
    rows = [("path", "model", "driver", "may be opened", "serial", "name")]
    examined = [search.examine_node(item) for item in items]
    for node in examined:
        item, driver = node.item, next(iter(node.fits), "-")
        allowed = "no: teleop devices rules" if node.not_ready_reason else "yes"
        rows.append((item.path, item.model, driver, allowed, item.serial, item.name))
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    table = [
        "  ".join(word.ljust(width) for word, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    advice = [f"{node.item.path}: {node.advice}" for node in examined if node.advice]
    users = [search.find_other_users(node.item) for node in examined if node.fits]
    return [*table, *advice, *filter(None, users), *arms]


def list_fitting_devices(items: Sequence[AttachedNode]) -> list[tuple[int, int, str]]:
    """Return vendor, product and name of the devices that a driver fits."""
    return [
        (item.vendor, item.product, item.name or item.model)
        for item in items
        if search.examine_node(item).fits
    ]


def select_device(find: str) -> AttachedNode:
    """Return the selected device, with or without a driver."""
    everything = search.list_attached_nodes()
    if not everything:
        raise UsageError(format_nodes([])[0])
    matches = [item for item in everything if search.is_match(item, find)]
    if len(matches) > 1:
        driven = [item for item in matches if search.examine_node(item).fits]
        matches = driven if len(driven) == 1 else matches
    if len(matches) == 1:
        return matches[0]
    table = "\n".join(format_nodes(matches or everything))
    request = (
        f"{find!r} is not attached"
        if not matches
        else "several devices match; give the path of one"
    )
    raise UsageError(f"{request}\n{table}")


def select_devices(find: str) -> list[AttachedNode]:
    """Return the selected device; all nodes of it if `find` matches several."""
    matches = [
        item for item in search.list_attached_nodes() if find and search.is_match(item, find)
    ]
    return matches or [select_device(find)]


def save_dump(items: Sequence[AttachedNode], file: Path | None) -> None:
    """Print the dump of each node, or write all to a file."""
    text = "---\n".join(format_dump(search.examine_node(item)) for item in items)
    if file is None:
        print(text, end="")
        return
    write_text_file(file, text, "the dump")
    print(f"written to {file}")


def probe_device(item: AttachedNode, watched_s: float) -> list[str]:
    """Return a device's descriptor as text, and its report rate."""
    node = search.examine_node(item)
    data = node.descriptor
    if not data:
        return [str(item), node.not_ready_reason]
    lines = [str(item)]
    lines += [f"driver {name}: {why_not or 'fits'}" for name, why_not in node.misfits.items()]
    try:
        lines += [
            "",
            f"report descriptor, {len(data)} bytes",
            *describe_descriptor(parse_descriptor(data)),
        ]
    except DescriptorError as error:
        lines.append(f"report descriptor, {len(data)} bytes, cannot be read: {error}")
    return [*lines, "", node.not_ready_reason or measure_report_rate(item, watched_s)]


def measure_report_rate(item: AttachedNode, watched_s: float) -> str:
    """Count the reports of a device for some time; return the result as text."""
    with closing(Node(item.path, str(item))) as node:
        node.drain()
        start, times = time.monotonic(), list[float]()
        while (now := time.monotonic()) - start < watched_s:
            times += [now] * len(node.drain())
            time.sleep(_POLL_PERIOD_S / 10.0)
    if len(times) < 2:
        return f"{len(times)} reports in {watched_s:.1f} s: some devices report only while moved"
    span = times[-1] - times[0]
    gap = max(b - a for a, b in itertools.pairwise(times))
    return (
        f"{len(times)} reports in {watched_s:.1f} s: {(len(times) - 1) / max(span, 1e-3):.0f} Hz "
        f"while it reported, longest gap {gap * 1e3:.1f} ms"
    )


def run_device_test(
    find: str, driver: str, file: Path | None, watched_s: float, person: OperatorDialogue
) -> None:
    """Guide a person through a test of all inputs and forces; save the signs found."""
    if switched := search.leave_console_mode(find, driver):
        person.write(switched)
    device = search.find_device(find, driver)
    if users := search.find_other_users(device.item):
        person.write(users)
    signs = force_signs.load(file) if file is None or file.exists() else force_signs.ForceSigns()
    forces = DRIVERS[device.kind].make(device.item, device.descriptor, PidConfig(), None).forces
    with _open_connection(device, ()) as line:
        person.write(f"{device.item}, driver {device.kind}")
        person.write(f"Move every axis to both ends and press every button ({watched_s:g} s).")
        for line_text in show_inputs(line, watched_s):
            person.write(line_text)
    if not forces:
        advice = search.examine_node(device.item).advice
        person.write(f"It has no force output{': ' * bool(advice)}{advice or '.'}")
    for axis in forces:
        with _open_connection(device, (axis,)) as line:  # one by one, for a device with one effect
            sign = determine_sign(line, axis, person)
        if not sign:
            person.write(f"{axis}: sign not found; it will render no force")
            continue
        signs = signs.replace_sign(ForceSign(*device.pusher, axis, 1 if sign > 0 else -1))
        force_signs.save(file, signs)
        person.write(f"{axis}: sign {sign:+d}, saved in {file or force_signs.get_default_path()}")
        if not device.item.serial:
            person.write(
                "It has no serial number: another device of this model, wired the other way, "
                "would get the same sign. Test again after replacing it."
            )


@contextmanager
def _open_connection(device: FoundDevice, pushed: tuple[str, ...]) -> Iterator[DeviceConnection]:
    line = DeviceConnection(device, PidConfig(), pushed)
    try:
        yield line
    finally:
        line.end(1.0)


def show_inputs(line: DeviceConnection, watched_s: float) -> list[str]:
    """Show the inputs for some time; return the range of each axis and the buttons pressed."""
    status, start = StatusLine(), time.monotonic()
    low: dict[str, float] = {}
    high: dict[str, float] = {}
    pressed = 0
    while (now := time.monotonic()) - start < watched_s:
        controls = line.read(now - start)
        for name, share in zip(line.driver.axes, controls.axes, strict=True):
            if not math.isnan(share):
                low[name] = min(low.get(name, share), share)
                high[name] = max(high.get(name, share), share)
        pressed |= controls.buttons
        status.show(_format_controls(line, controls))
        time.sleep(_POLL_PERIOD_S)
    status.clear()
    axes = [
        f"  {name:8s} {low[name]:+.2f} ... {high[name]:+.2f}" if name in low
        else f"  {name:8s} no report"
        for name in line.driver.axes
    ]  # fmt: skip
    buttons = [str(k + 1) for k in range(line.driver.buttons) if pressed >> k & 1]
    return [
        "axes, shares of full scale:",
        *axes,
        f"buttons seen, of {line.driver.buttons}: {' '.join(buttons) or 'none'}",
    ]


def _format_controls(line: DeviceConnection, controls: Controls) -> str:
    axes = " ".join(
        f"{name} {share:+.2f}" for name, share in zip(line.driver.axes, controls.axes, strict=True)
    )
    held = (str(k + 1) for k in range(line.driver.buttons) if controls.buttons >> k & 1)
    return f"{axes}  buttons {' '.join(held)}"


def determine_sign(line: DeviceConnection, axis: str, person: OperatorDialogue) -> int:
    """Find the sign of one axis by pushing it, or else by asking; 0 = not found."""
    force_max = f"{force_signs.TEST_FORCES[-1]:.0%}"
    answer = _ask_operator(
        person,
        f"Release the device and keep clear: {axis} is pushed with up to {force_max} of its force. "
        "Enter to go on, s to leave it out: ",
    )
    if answer.startswith("s"):
        return 0
    place, force = line.driver.axes.index(axis), line.driver.forces.index(axis)
    count = len(line.driver.forces)
    sign = force_signs.find_sign(line, place, force, count, time.monotonic, time.sleep)
    if sign:
        return sign
    person.write(f"{axis} did not move.")
    answer = _ask_operator(
        person,
        "Hold it half-way (pull a trigger slowly through); it is pushed twice for 2 s. Enter to "
        "go on, s to leave it out: ",
    )
    if answer.startswith("s"):
        return 0
    for share, direction in ((force_signs.TEST_FORCES[-1], 1), (-force_signs.TEST_FORCES[-1], -1)):
        force_signs.hold_force(line, force, count, share, time.monotonic, time.sleep)
        reply = ""
        while reply[:1] not in _ANSWERS:
            reply = _ask_operator(
                person,
                "Did it push to [l]arger values, to [s]maller ones, or did you feel [n]one? ",
            )
        if _ANSWERS[reply[0]]:
            return direction * _ANSWERS[reply[0]]
    return 0


def _ask_operator(person: OperatorDialogue, question: str) -> str:
    sys.stdout.flush()
    try:
        return person.prompt(question).strip().lower()
    except EOFError as error:
        raise UsageError("teleop devices test: needs a terminal for the answers") from error
