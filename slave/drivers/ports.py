"""Serial ports of this machine: lasting names, slow adapters, and who has them open."""

import grp
import os
import pwd
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from slave.drivers.driver import DriverFault
from teleop.runtime.machine import find_container, find_usb_remedy
from teleop.runtime.process import find_openers, is_running

DEVICES = Path("/dev")
TTYS = Path("/sys/class/tty")
NETWORK = Path("/sys/class/net")
LATENCY_MAX_MS = 2
_CAN_INTERFACE = "280"  # ARPHRD_CAN
_RULES = "/etc/udev/rules.d"
_ELSEWHERE = {"Windows": r"(?i)com\d+$", "macOS": r"/dev/(cu|tty)\."}  # names of ports there
_DAEMONS = {  # programs that take adapters by themselves, and what keeps them off
    "ModemManager": "asks each new port whether it is a modem: put "
    'ATTRS{{idVendor}}=="{vendor}", ENV{{ID_MM_DEVICE_IGNORE}}="1" into '
    f"{_RULES}/70-serial.rules and plug in again",
    "brltty": "takes CH340, CP210x and FTDI adapters for braille displays: "
    f"sudo ln -s /dev/null {_RULES}/85-brltty.rules, and plug in again",
}


def list_ports() -> dict[str, str]:
    """Return the device files of serial adapters, and the lasting name of each; empty if none.

    Adapters of one model without serial numbers share a name in by-id, that of the one plugged in
    last; then their names in by-path count, which are of the sockets.
    """
    kinds = ("ttyUSB*", "ttyACM*")
    devices = sorted(str(path.resolve()) for kind in kinds for path in DEVICES.glob(kind))
    by_id, by_path = (
        {str(link.resolve()): str(link) for link in sorted((DEVICES / "serial" / kind).glob("*"))}
        for kind in ("by-id", "by-path")
    )
    nameless = {
        _read_model(device) for device in devices if device in by_path.keys() - by_id.keys()
    }
    return {
        device: (by_path if _read_model(device) in nameless else by_id).get(device, "")
        for device in devices
    }


def require_lasting_name(port: str) -> None:
    """Raise `DriverFault` if another adapter may have this name after the next replug."""
    lasting = list_ports().get(os.path.realpath(port), "")
    kinds = Path(port).parent.name, Path(lasting).parent.name
    if not lasting or port == lasting or (os.path.islink(port) and kinds != ("by-id", "by-path")):
        return  # by-path, another name of by-id, or one of a rule of the user's
    raise DriverFault(
        f"{port}: may be another adapter after the next replug, so nothing is moved: set it to "
        f"{lasting}"
    )


def find_slow_timer(port: str) -> str:
    """Return what to do about an adapter's latency timer; empty if it is short or unknown."""
    name = Path(port).resolve().name
    try:
        latency_ms = int((TTYS / name / "device/latency_timer").read_text())  # of FTDI adapters
    except (OSError, ValueError):
        return ""
    if latency_ms <= LATENCY_MAX_MS:
        return ""
    return (
        f"the adapter's latency timer is {latency_ms} ms: echo 1 | sudo tee "
        f"/sys/class/tty/{name}/device/latency_timer (for good: docs/how-to/rigs.md)"
    )


def find_users(port: str) -> str:
    """Return the programs that have a port open, with what ends that; empty if none is known."""
    if os.path.realpath(port).startswith("/dev/pts/"):  # of a program, which has it open itself
        return ""
    users = ", ".join(find_openers(port))
    return users and f"in use by {users}: {_find_remedy(port, users) or 'end it first'}"


def explain_busy(port: str) -> str:
    """Return who may have a port that cannot be opened: programs of others are hidden."""
    suspect = "" if os.geteuid() == 0 else _find_remedy(port, "")
    return find_users(port) or f"in use by another program: {suspect or 'end it first'}"


def explain_missing(port: str = "") -> str:
    """Return why an adapter may have no device file, or which others have; empty if unknown."""
    attached = ", ".join(name or device for device, name in list_ports().items())
    system = next((name for name, pattern in _ELSEWHERE.items() if re.match(pattern, port)), "")
    hints = (
        f"that is a name of {system}" if system else "",
        f"brltty {_DAEMONS['brltty']}" if is_running("brltty") else "",
        f"attached: {attached}" if attached and port else "",
        "" if attached else find_usb_remedy("/dev/ttyUSB0"),
    )
    return "".join(f": {hint}" for hint in hints if hint)


def explain_denied(port: str) -> str:
    """Return what gives this user the right to open a port; empty if the user has it."""
    if os.access(port, os.R_OK | os.W_OK) or not os.path.exists(port):
        return ""
    status, real = os.stat(port), os.path.realpath(port)
    group, user = str(status.st_gid), str(os.geteuid())
    members: list[str] = []
    with suppress(KeyError):
        group, _, _, members = grp.getgrgid(status.st_gid)
        user = pwd.getpwuid(os.geteuid()).pw_name
    if find_container():
        return f"no permission: docker run --group-add {status.st_gid} ..."
    if status.st_gid == 0 or status.st_mode & 0o060 != 0o060:
        return (
            f'no permission, as it is not of a group: put SUBSYSTEM=="tty", ATTRS{{idVendor}}=='
            f'"{_read_model(real)[0]}", GROUP="dialout", MODE="0660" into {_RULES}/70-serial.rules '
            "and plug in again"
        )
    if user in members:
        return f"no permission yet: you are in the group {group} from your next login on"
    return f"no permission: sudo usermod -aG {group} $USER, then log in again"


def find_problems(port: str) -> list[str]:
    """Return what keeps a port from being used, each with its remedy."""
    problems = (find_users(port), find_slow_timer(port), explain_denied(port))
    return [problem for problem in problems if problem]


def describe_interfaces() -> Iterator[str]:
    """Yield serial ports by their lasting names, and CAN interfaces, with what is wrong."""
    for device, name in list_ports().items():
        line = f"{name} -> {device}" if name else device
        yield "; ".join([line, *find_problems(device)])
    for place in list_can_interfaces():
        yield f"CAN {place.name}: {(place / 'operstate').read_text().strip()}"


def list_can_interfaces() -> list[Path]:
    """Return the folders of the CAN interfaces of this machine, which have their names."""
    kinds = sorted(NETWORK.glob("*/type"))
    return [kind.parent for kind in kinds if kind.read_text().strip() == _CAN_INTERFACE]


def explain_missing_can() -> str:
    """Return which CAN interfaces there are, or why there is none; empty if that is unknown."""
    if names := ", ".join(place.name for place in list_can_interfaces()):
        return f": there is {names}"
    if find_container():
        return ": a container has those of the machine with docker run --network host"
    return ""


def _find_remedy(port: str, users: str) -> str:
    """Return what keeps a daemon off, one of `users`; without users, one that is running."""
    for name, remedy in _DAEMONS.items():
        if name in users or (not users and is_running(name)):
            return f"{name} {remedy.format(vendor=_read_model(os.path.realpath(port))[0])}"
    return ""


def _read_model(port: str) -> tuple[str, str]:
    """Return vendor and product of an adapter on USB, as a udev rule has them."""
    device = (TTYS / Path(port).name / "device").resolve()
    for folder in (device, *device.parents):
        with suppress(OSError):
            vendor, product = ((folder / name).read_text() for name in ("idVendor", "idProduct"))
            return vendor.strip(), product.strip()
    return "VENDOR", ""
