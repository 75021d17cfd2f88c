"""A remote-controlled process of ours: on command it injects faults that a test cannot inject.

    python -m studies.faults.faulty_process COMMAND ARGUMENTS ...  as `teleop COMMAND ARGUMENTS ...`

Words on standard input, one a line: `unplug`, `plug` (the haptic device), `clock S` (the machine's
monotonic clock jumps by S seconds for this process), `wall S` (its wall clock; see wall_clock.c),
`hog` (allocate memory without end), `descriptors` and `free` (take all file descriptors, and give
them back).
"""

import ctypes
import os
import resource
import sys
import threading
import time


class Strings:
    """The faults that are injected."""

    def __init__(self):
        self.away = False
        self.offset_ns = 0
        self._taken = []
        self._limit = resource.getrlimit(resource.RLIMIT_NOFILE)

    def obey(self, lines):
        for line in lines:
            word, *numbers = line.split()
            if word in ("plug", "unplug"):
                self.away = word == "unplug"
            elif word == "clock":
                self.offset_ns += round(float(numbers[0]) * 1e9)
            elif word == "wall":
                step = round(float(numbers[0]) * 1e9)
                ctypes.CDLL(None).step_wall_clock(ctypes.c_longlong(step))
            elif word == "hog":
                memory = bytearray()
                while True:
                    memory.extend(bytes(1 << 20))
                    time.sleep(0.001)  # the loop goes on until it is killed
            elif word == "descriptors":
                self._take_descriptors()
            elif word == "free":
                while self._taken:
                    os.close(self._taken.pop())
                resource.setrlimit(resource.RLIMIT_NOFILE, self._limit)

    def _take_descriptors(self):
        highest = max(map(int, os.listdir("/proc/self/fd")))
        resource.setrlimit(resource.RLIMIT_NOFILE, (highest + 1, self._limit[1]))
        try:
            while True:
                self._taken.append(os.dup(0))
        except OSError:
            return


def make_unpluggable(open_device, strings):
    """Return `open_device` with the device's plug in our hand."""
    from master.device import DeviceLost

    class Unpluggable:
        def __init__(self, device):
            self.axes, self._device = device.axes, device

        def read(self, time_s):
            if strings.away:
                raise DeviceLost("unplugged")
            return self._device.read(time_s)

        def write(self, force):
            self._device.write((0.0,) * self.axes if strings.away else force)

        def close(self):
            self._device.close()

    return lambda *arguments, **options: Unpluggable(open_device(*arguments, **options))


def main():
    strings = Strings()
    clock = time.monotonic_ns
    time.monotonic_ns = lambda: clock() + strings.offset_ns  # before our modules take hold of it
    threading.Thread(target=strings.obey, args=(sys.stdin,), daemon=True).start()

    from teleop.cli import commands

    if sys.argv[1] == "master":
        from master import process

        process.open_device = make_unpluggable(process.open_device, strings)
    return commands.main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
