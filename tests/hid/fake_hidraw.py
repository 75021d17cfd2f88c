"""A stand-in for hidapi's module `hidraw`, with its quirks, and virtual devices behind it.

As measured with hidapi 0.15 on Linux: reads give lists of numbers; a blocking read with
`timeout_ms=0` waits for ever (here it fails the test); a failed write returns -1; an unplugged
device raises `OSError` on read; 64 reports are kept for a reader, and what comes then is dropped.
What would be undefined behaviour there (a handle closed while a thread is inside) is noted in
`misuse`, which a test should find empty.
"""

import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from studies.hid.virtual.device import BLUETOOTH, VirtualDevice

QUEUE = 64
_HANG_S = 5.0  # what Linux gives a device to take a report
_BUS = {BLUETOOTH: 2}


class Node:
    """A plugged-in device: what a test sees of it."""

    def __init__(
        self, bus: "FakeHidraw", device: VirtualDevice, path: Path, usages, interface: int
    ) -> None:
        self.bus, self.device, self.path, self.interface = bus, device, path, interface
        self.permitted = True
        self.there = True
        self.written: list[bytes] = []
        self.refuses = False  # writes return -1, although it is there
        self.stalled = threading.Event()  # set = writes hang until it is cleared
        self.inside = threading.Event()  # a write is hanging
        self.talking = True  # sends what the device says; else only what a test pushes
        self.usages = usages
        self.lock = threading.RLock()
        self.handles: list[Handle] = []
        self._said_s = bus.clock()

    def push(self, *reports: bytes) -> None:
        with self.lock:
            for report in reports:
                for handle in self.handles:
                    if len(handle.queue) < QUEUE:
                        handle.queue.append(bytes(report))

    def pump(self) -> None:
        """Let the device say what it has been saying since the last time."""
        with self.lock:
            now = self.bus.clock()
            count = int((now - self._said_s) / self.device.interval)
            if not self.talking or count <= 0:
                return
            self._said_s += count * self.device.interval
            for _ in range(min(count, 2 * QUEUE)):
                self.push(*self.device.build_inputs(now))

    def force(self) -> tuple[float, ...]:
        """Return what the device does to the hand now."""
        with self.lock:
            self.device.build_inputs(self.bus.clock())
            return self.device.pushes[-1].force


class Handle:
    """`hidraw.device()`."""

    def __init__(self, bus: "FakeHidraw") -> None:
        self.queue: deque[bytes] = deque()
        self._bus, self._node, self._blocking = bus, None, True
        self._inside = 0

    def open_path(self, path: bytes) -> None:
        node = self._bus.nodes.get(path)
        if node is None or not node.permitted:
            raise OSError("open failed")
        node.pump()  # what it said before is nobody's
        self._node = node
        node.handles.append(self)

    def close(self) -> None:
        if self._node is not None:
            if self._inside:
                self._bus.misuse.append("closed while in use")
            self._node.handles.remove(self)
            self._node = None

    def set_nonblocking(self, yes: int) -> int:
        self._open()
        self._blocking = not yes
        return 0

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        node = self._open()
        if not node.there:
            raise OSError("read error")
        node.pump()
        with node.lock:
            if self.queue:
                return list(self.queue.popleft()[:max_length])
        if self._blocking and timeout_ms == 0:
            self._bus.misuse.append("read without end")
            raise AssertionError("this read would wait for ever")
        return []

    def write(self, buff: bytes) -> int:
        node = self._open()
        self._inside += 1
        try:
            if node.stalled.is_set():
                node.inside.set()
                end = time.monotonic() + _HANG_S
                while node.stalled.is_set() and time.monotonic() < end:
                    time.sleep(0.001)
                return -1
            if not node.there or node.refuses:
                return -1
            with node.lock:
                node.written.append(bytes(buff))
                node.device.take_output(self._bus.clock(), bytes(buff))
            return len(buff)
        finally:
            self._inside -= 1

    def send_feature_report(self, buff: bytes) -> int:
        node = self._open()
        if not node.there:
            return -1
        with node.lock:
            node.device.set_feature(self._bus.clock(), bytes(buff))
        return len(buff)

    def get_feature_report(self, report_num: int, max_length: int) -> list[int]:
        node = self._open()
        with node.lock:
            report = node.device.get_feature(self._bus.clock(), report_num) if node.there else None
        if report is None:
            raise OSError("read error")
        return list(report[:max_length])

    def get_input_report(self, report_num: int, max_length: int) -> list[int]:
        node = self._open()
        with node.lock:
            report = node.device.get_input(self._bus.clock(), report_num) if node.there else None
        if report is None:
            raise OSError("read error")
        return list(report[:max_length])

    def get_report_descriptor(self) -> list[int]:
        node = self._open()
        if not node.there:
            raise OSError("failed to get report descriptor")
        return list(node.device.descriptor)

    def _open(self) -> Node:
        if self._node is None:
            raise ValueError("not open")
        return self._node


class FakeHidraw:
    """The module. Paths are real files in `folder`, which a guard process can open.

    Parameters
    ----------
    clock : callable
        The time [s] that devices live in.
    """

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self.nodes: dict[bytes, Node] = {}
        self.misuse: list[str] = []
        self.clock = clock
        self._folder, self._count = folder, 0

    def plug(self, device: VirtualDevice, usages=((0x01, 0x04),), interface: int = 0) -> Node:
        path = self._folder / f"fake-hidraw{self._count}"
        self._count += 1
        path.touch()
        node = Node(self, device, path, usages, interface)
        self.nodes[str(path).encode()] = node
        return node

    def unplug(self, node: Node) -> None:
        """Pull it out; those who have it open find out when they use it."""
        node.there = False
        del self.nodes[str(node.path).encode()]
        node.path.unlink()

    def enumerate(self, vendor_id: int = 0, product_id: int = 0) -> list[dict]:
        return [
            {
                "path": path,
                "vendor_id": node.device.vendor,
                "product_id": node.device.product,
                "serial_number": node.device.serial,
                "release_number": 0x0100,
                "manufacturer_string": "",
                "product_string": node.device.name,
                "usage_page": page,
                "usage": usage,
                "interface_number": node.interface,
                "bus_type": _BUS.get(node.device.bus, 1),
            }
            for path, node in self.nodes.items()
            if vendor_id in (0, node.device.vendor) and product_id in (0, node.device.product)
            for page, usage in node.usages
        ]

    def device(self) -> Handle:
        return Handle(self)
