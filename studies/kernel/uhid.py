"""A virtual device in the kernel: what `linux/uhid.h` needs, and no more.

Events are a number and a packed struct each, host byte order. The kernel always hands out whole
events of the largest size; it takes shorter ones.
"""

import os
import struct

from tests.hid.virtual.device import VirtualDevice

_DESTROY, _OUTPUT, _GET_REPORT, _GET_REPORT_REPLY = 1, 6, 9, 10
_CREATE2, _INPUT2, _SET_REPORT, _SET_REPORT_REPLY = 11, 12, 13, 14
_INPUT_REPORT = 2  # kind of report that is got
_LARGEST = 4380
_DATA_MAX = 4096
_EIO = 5


class Uhid:
    """Plugs a virtual device into the kernel, and carries the bytes between the two.

    Without a thread: it becomes readable when the kernel wants something; then call `handle`.
    """

    def __init__(self, device: VirtualDevice) -> None:
        self._device = device
        self._fd = os.open("/dev/uhid", os.O_RDWR | os.O_CLOEXEC)
        self._write(
            _CREATE2,
            struct.pack(
                "=128s64s64sHHIIII",
                device.name.encode(),
                b"",
                device.serial.encode(),
                len(device.descriptor),
                device.bus,
                device.vendor,
                device.product,
                0x0111,
                0,
            )
            + device.descriptor,
        )

    def fileno(self) -> int:
        """Return what `select` can wait for."""
        return self._fd

    def close(self) -> None:
        """Pull the device out."""
        self._write(_DESTROY, b"")
        os.close(self._fd)

    def send(self, report: bytes) -> None:
        """Hand an input report to the kernel."""
        self._write(_INPUT2, struct.pack("=H", len(report)) + report)

    def handle(self, now: float) -> None:
        """Take one event: an output report, or a feature to set or to get."""
        event = os.read(self._fd, _LARGEST)
        (kind,) = struct.unpack_from("=I", event)
        if kind == _OUTPUT:
            (size,) = struct.unpack_from("=H", event, 4 + _DATA_MAX)
            self._device.output(now, event[4 : 4 + size])
        elif kind == _GET_REPORT:
            number, report, kind = struct.unpack_from("=IBB", event, 4)
            device = self._device
            ask = device.get_input if kind == _INPUT_REPORT else device.get_feature
            answer = ask(now, report)
            head = struct.pack("=IHH", number, 0 if answer else _EIO, len(answer or b""))
            self._write(_GET_REPORT_REPLY, head + (answer or b""))
        elif kind == _SET_REPORT:
            number, _report, _type, size = struct.unpack_from("=IBBH", event, 4)
            self._device.set_feature(now, event[12 : 12 + size])
            self._write(_SET_REPORT_REPLY, struct.pack("=IH", number, 0))

    def _write(self, kind: int, body: bytes) -> None:
        os.write(self._fd, struct.pack("=I", kind) + body)
