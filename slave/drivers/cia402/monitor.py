"""What a CAN bus tells beside the answers that are waited for: who is alive, what goes wrong."""

import json
import subprocess
from collections import Counter
from collections.abc import Callable
from typing import Any

import can

from slave.drivers.cia402.codes import format_emergency
from slave.drivers.cia402.config import BusConfig

EMERGENCY, SDO_ANSWER, HEARTBEAT = 0x80, 0x580, 0x700
_FROM_NODES = (EMERGENCY, 0x180, 0x280, 0x380, 0x480, SDO_ANSWER, HEARTBEAT)
# classes of error frames and their details (linux/can/error.h)
_CONTROLLER, _PROTOCOL, _NO_ACKNOWLEDGE, BUS_OFF = 0x04, 0x08, 0x20, 0x40
_DISTURBED = 1 << 29  # ours: _PROTOCOL at another place
_RECEIVE_PASSIVE, _SEND_PASSIVE = 0x10, 0x20  # bits of byte 1 of _CONTROLLER
_ACKNOWLEDGE_SLOTS = (0x19, 0x1B)  # values of byte 3 of _PROTOCOL

BUS_OFF_TEXT = "bus off: check bit rate, termination (120 ohm at both ends) and cable"


class BusMonitor(can.Listener):
    """Takes every frame; says why a node does not answer.

    Of an slcan adapter `count_refusals` returns how many frames it has refused to send, and
    `damaged` counts lines that could not be read.
    """

    def __init__(self, bus: BusConfig) -> None:
        self._bus = bus
        self._heard: set[int] = set()  # nodes
        self._answers: Counter[int] = Counter()  # to SDO requests, by node
        self._emergencies: dict[int, int] = {}  # newest code that was not reset, by node
        self._bus_off = self._unacknowledged = self._disturbed = False
        self.count_refusals: Callable[[], int] = lambda: 0
        self.damaged = 0

    def on_message_received(self, msg: can.Message) -> None:
        """Take a frame."""
        kind, number, data = msg.arbitration_id & 0x780, msg.arbitration_id & 0x7F, bytes(msg.data)
        if msg.is_error_frame:
            self._take_error(msg.arbitration_id, data.ljust(8, b"\0"))
        elif number and kind in _FROM_NODES and not (msg.is_extended_id or msg.is_remote_frame):
            self._heard.add(number)
            self._answers[number] += kind == SDO_ANSWER
            if kind == EMERGENCY and len(data) >= 2:
                self._emergencies[number] = int.from_bytes(data[:2], "little")

    def _take_error(self, classes: int, data: bytes) -> None:
        self._bus_off |= bool(classes & BUS_OFF)
        passive = data[1] if classes & _CONTROLLER else 0
        if classes & _PROTOCOL:
            classes |= _NO_ACKNOWLEDGE if data[3] in _ACKNOWLEDGE_SLOTS else _DISTURBED
        self._unacknowledged |= bool(classes & _NO_ACKNOWLEDGE or passive & _SEND_PASSIVE)
        self._disturbed |= bool(classes & _DISTURBED or passive & _RECEIVE_PASSIVE)

    def forget_errors(self) -> None:
        """Forget what was wrong with the bus: all nodes have answered since."""
        self._bus_off = self._unacknowledged = self._disturbed = False

    @property
    def nodes(self) -> list[int]:
        """Nodes that have sent anything."""
        return sorted(self._heard)

    def describe_emergency(self, number: int) -> str:
        """Return the newest emergency of a node in words; empty if there is none."""
        code = self._emergencies.get(number, 0)
        return format_emergency(code) if code else ""

    def forget_answers(self, number: int) -> None:
        """Forget the SDO answers of a node: one that comes from now on is late."""
        self._answers[number] = 0

    def count_answers(self, number: int) -> int:
        """Return how many SDO answers of a node came since they were forgotten."""
        return self._answers[number]

    def explain_errors(self) -> str:
        """Return what is wrong with the bus itself, with the next step; empty if nothing is."""
        if self._bus_off:
            return BUS_OFF_TEXT
        bitrate = f"bit rate ({self._bus.bitrate} in the config)"
        if self._disturbed:
            return (
                f"frames are damaged: another {bitrate} than the drives', termination missing (120 "
                "ohm at both ends: 60 between CAN_H and CAN_L), or two nodes of one number"
            )
        if self._unacknowledged or self.count_refusals():
            return (
                "no node acknowledges frames: are the drives powered and connected, "
                f"{bitrate} and termination right?"
            )
        if self.damaged:
            return f"{self.damaged} damaged lines of the adapter: is tty_baud right?"
        return ""

    def explain_silence(self, number: int, timeout_s: float) -> str:
        """Return why a node has not answered an SDO request, with the next step."""
        if self.count_answers(number):
            return (
                f"answers SDO requests later than {timeout_s * 1e3:g} ms: is it still starting, or "
                "does another program speak to it?"
            )
        if emergency := self.describe_emergency(number):
            return f"does not answer SDO requests, and reports: {emergency}"
        if number in self._heard:
            return (
                "is alive (heartbeat), but does not answer SDO requests: switch it off and on; "
                "enable SDO in its own tool"
            )
        others = ", ".join(map(str, self.nodes))
        return "does not answer: " + (
            self.explain_errors()
            or (others and f"nodes {others} are alive: is its number right? (`teleop rig scan`)")
            or f"no frame arrives: power, cable, number, bit rate ({self._bus.bitrate})?"
        )


# --- a SocketCAN interface, as the kernel tells of it


def read_interface(channel: str) -> dict[str, Any]:
    """Return what `ip` tells of a network interface; empty if it tells nothing."""
    command = ["ip", "-details", "-json", "link", "show", "dev", channel]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=2.0, check=True)
        found: dict[str, Any] = json.loads(done.stdout)[0]
    except (OSError, subprocess.SubprocessError, ValueError, IndexError):
        return {}
    return found


def find_interface_fault(interface: dict[str, Any], bus: BusConfig) -> str:
    """Return why a CAN interface carries no frames, with the command that helps; empty if none."""
    name, up = bus.channel, f"sudo ip link set {bus.channel} up"
    if "UP" not in interface.get("flags", ["UP"]):
        return f"is down: {up} type can bitrate {bus.bitrate}"
    link_info = interface.get("linkinfo", {}).get("info_data", {})
    if link_info.get("state") == "BUS-OFF":
        return f"{BUS_OFF_TEXT}; then: sudo ip link set {name} down; {up}"
    bitrate = link_info.get("bittiming", {}).get("bitrate", bus.bitrate)
    if bitrate != bus.bitrate:
        return (
            f"runs at {bitrate} bit/s, bus.bitrate is {bus.bitrate}: correct that, or: "
            f"sudo ip link set {name} down; {up} type can bitrate {bus.bitrate}"
        )
    return ""
