"""The drivers of hands need neither network nor compiler: the kernel run's guest has none."""

import subprocess
import sys

LIGHT = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("numba", "scipy", "xxhash", "zenoh"):
            raise ImportError(name)
sys.meta_path.insert(0, Blocked())
import master.devices.hid.device, master.devices.combined
"""


def test_a_driver_needs_neither_network_nor_compiler():
    done = subprocess.run(
        [sys.executable, "-c", LIGHT], check=False, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
