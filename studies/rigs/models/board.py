"""The firmware of `firmware/`, compiled for this machine, on a pty with a plant."""

import ctypes
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np

from studies.rigs.models.line import BusThread, PseudoPort
from studies.rigs.models.plant import Springs

FIRMWARE = Path(__file__).parents[3] / "firmware"
COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
FLAGS = ["-std=c++14", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-O0", "-fPIC", "-shared"]
ENABLED, WATCHDOG, STOPPED = 1, 2, 4


def compile_firmware(folder: Path) -> Path:
    """Compile the protocol code with the host's board; return the library."""
    out = folder / "firmware.so"
    sources = [FIRMWARE / "host" / "host.cpp", *sorted((FIRMWARE / "teleop_rig").glob("*.cpp"))]
    subprocess.run(
        [COMPILER, *FLAGS, "-o", str(out), *map(str, sources)], check=True, capture_output=True
    )
    return out


class Firmware:
    """The compiled code: bytes in, bytes out, at times that the caller says."""

    def __init__(self, library: Path, motors: int, cells: int) -> None:
        self._lib = ctypes.CDLL(str(library))
        self._lib.host_open.restype = ctypes.c_void_p
        self._lib.host_sent.restype = ctypes.c_size_t
        self._host = ctypes.c_void_p(self._lib.host_open(motors, cells))
        self.motors, self.cells = motors, cells
        self._now_us = 0
        self._targets = (ctypes.c_int32 * motors)()
        self._on = (ctypes.c_uint8 * motors)()
        self._out = (ctypes.c_uint8 * 4096)()

    def receive(self, data: bytes, now_us: int | None = None) -> None:
        """Take bytes at a time of the watchdog's clock, that of the last step if none is given."""
        self._now_us = self._now_us if now_us is None else now_us & 0xFFFFFFFF
        now = ctypes.c_uint32(self._now_us)
        self._lib.host_receive(self._host, now, data, ctypes.c_size_t(len(data)))

    def step(
        self, now_us: int, sampled: bool, positions, cells, fault=False, watchdog_us=None
    ) -> None:
        """Run the sketch's loop once; `watchdog_us` is another clock for the watchdog."""
        watchdog_us = now_us if watchdog_us is None else watchdog_us
        self._now_us = watchdog_us & 0xFFFFFFFF
        self._lib.host_step(
            self._host,
            ctypes.c_uint32(watchdog_us & 0xFFFFFFFF),
            ctypes.c_uint32(now_us & 0xFFFFFFFF),
            ctypes.c_bool(sampled),
            ctypes.c_bool(fault),
            (ctypes.c_int32 * self.motors)(*[round(v) for v in positions]),
            (ctypes.c_int32 * self.cells)(*[round(v) for v in cells]),
        )

    def read_motors(self) -> tuple[int, np.ndarray, np.ndarray]:
        """Return flags, targets [counts] and which motors have power."""
        flags = self._lib.host_motors(self._host, self._targets, self._on)
        return flags & 0xFF, np.array(self._targets, float), np.array(self._on, bool)

    def sent(self) -> bytes:
        count = self._lib.host_sent(self._host, self._out, ctypes.c_size_t(len(self._out)))
        return bytes(self._out[:count])


class Board(BusThread):
    """A board with its motors' plant; `serve` runs until `ended` is set.

    Its watchdog waits `patience` times as long as told: a busy machine holds up the driver, too.
    """

    RATE_HZ = 1000.0

    def __init__(
        self,
        library: Path,
        motors: int = 1,
        cells: int = 1,
        plant=None,
        patience: float = 10.0,
        link: Path | None = None,
    ) -> None:
        self._patience = patience
        self.port = PseudoPort(link)
        self.firmware = Firmware(library, motors, cells)
        self.plant = plant or Springs(max(motors, cells))
        self.flip = 0  # frames to damage by one bit, of those that it sends
        self.silent, self.fault, self.flags = False, False, 0
        self.stopped_s = 0.0  # when its watchdog has stopped the motors last, monotonic clock
        self._start_s = time.monotonic()

    def serve(self) -> None:
        due_s = time.monotonic()
        while not self.ended:
            data = self.port.read(max(0.0, min(0.001, due_s - time.monotonic())))
            now = time.monotonic()
            now_us = (now - self._start_s) * 1e6
            self.firmware.receive(data, round(now_us / self._patience))
            sampled = now >= due_s
            if sampled:
                due_s = max(due_s + 1.0 / self.RATE_HZ, now - 0.01)
                self._advance(now)
            motors, cells = self.firmware.motors, self.firmware.cells
            self.firmware.step(
                round(now_us),
                sampled,
                self.plant.position[:motors],
                self.plant.read_cells()[:cells],
                self.fault,
                round(now_us / self._patience),
            )
            flags = self.firmware.read_motors()[0]
            if flags & WATCHDOG and not self.flags & WATCHDOG:
                self.stopped_s = now
            self.flags = flags
            self._send(self.firmware.sent())
        self.port.unplug()

    def _advance(self, now: float) -> None:
        _, target, powered = self.firmware.read_motors()
        spare = len(self.plant.position) - len(target)
        self.plant.advance(
            now - self._start_s, np.pad(target, (0, spare)), np.pad(powered, (0, spare))
        )

    def _send(self, data: bytes) -> None:
        if not data or self.silent:
            return
        if self.flip > 0:
            self.flip -= 1
            data = data[:3] + bytes([data[3] ^ 0x10]) + data[4:]
        self.port.write(data)
