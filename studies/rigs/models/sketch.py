"""The sketch of `firmware/`, all of it, compiled against a stub of the Arduino core."""

import ctypes
import subprocess
from pathlib import Path

from studies.rigs.models.board import COMPILER, FIRMWARE, FLAGS


def compile_sketch(folder: Path) -> Path:
    """Compile the sketch with the stub of `firmware/host/arduino`; return the library."""
    out = folder / "sketch.so"
    host = FIRMWARE / "host"
    include = [f"-I{host / 'arduino'}", f"-I{FIRMWARE / 'teleop_rig'}"]
    sources = [host / "sketch.cpp", *sorted((FIRMWARE / "teleop_rig").glob("*.cpp"))]
    command = [COMPILER, *FLAGS, *include, "-o", str(out), *map(str, sources)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out


class Sketch:
    """The sketch with its own clock, its pins, and a model of the ADS1256 on its SPI bus."""

    def __init__(self, library: Path) -> None:
        self.lib = ctypes.CDLL(str(library))
        self.lib.sketch_sent.restype = ctypes.c_size_t
        self.lib.sketch_now_us.restype = ctypes.c_uint64
        self._out = (ctypes.c_uint8 * 65536)()

    def run(self, duration_s: float) -> bytes:
        """Let `loop` run for a time of the board's clock; return what it has sent."""
        self.lib.sketch_run(ctypes.c_uint32(round(duration_s * 1e6)))
        count = self.lib.sketch_sent(self._out, ctypes.c_size_t(len(self._out)))
        return bytes(self._out[:count])

    def receive(self, data: bytes) -> None:
        self.lib.sketch_receive(data, ctypes.c_size_t(len(data)))
