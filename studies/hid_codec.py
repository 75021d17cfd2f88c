"""What the codec of a force-feedback device costs in a tick: read one report, write the force.

python studies/hid_codec.py

Each layout is read and written through its report descriptor. Beside it, from the same run, stands
the same work for OpenFFBoard by `struct`, as one would write it for that board alone.
"""

import struct
import timeit
from collections.abc import Callable

from master.devices.hid.driver import build_unknown_controls
from master.devices.hid.pid import PidDriver
from studies.hid.descriptors import arduino, ffbeast_pid, openffboard, rhino

TICKS, RUNS = 20_000, 5
LIMIT_US = 20.0

INPUT = struct.Struct("<BQ8h")
FORCE = struct.Struct("<BBh")


class Answers:
    """A device that gives its effects the numbers 1, 2, ..."""

    def __init__(self) -> None:
        self._made = 0

    def write(self, report: bytes) -> None:
        """Take a report."""

    def send_feature(self, report: bytes) -> None:
        """Make an effect."""
        del report
        self._made += 1

    def get_input(self, number: int, length: int) -> bytes:
        """Return a state without any flag."""
        return bytes([number]).ljust(length, b"\0")

    def get_feature(self, number: int, length: int) -> bytes:
        """Return that it was made."""
        return bytes([number, self._made, 1]).ljust(length, b"\0")


def microseconds(work: Callable[[], object]) -> float:
    return min(timeit.repeat(work, number=TICKS, repeat=RUNS)) / TICKS * 1e6


def by_hand(report: bytes, force: tuple[float, float]) -> tuple[float, int, bytes, bytes]:
    _, buttons, x, *_ = INPUT.unpack(report)
    pushes = [
        FORCE.pack(5, k + 1, round(max(-1.0, min(1.0, share)) * 32767))
        for k, share in enumerate(force)
    ]
    return x / 32767, buttons, pushes[0], pushes[1]


def main() -> None:
    force = (0.25, -0.5)
    report = INPUT.pack(1, 0xF00D, *range(-4000, 4000, 1000))
    base = microseconds(lambda: by_hand(report, force))
    print(f"{'layout':24}{'read us':>10}{'write us':>10}{'arm us':>10}{'both us':>10}")
    print(f"{'openffboard by struct':24}{'':30}{base:10.2f}")
    reports = {
        "openffboard, 2 axes": (openffboard(), report),
        "openffboard, 1 axis": (openffboard(1), report),
        "arduino": (arduino(), struct.pack("<BIBhh", 1, 5, 3, 100, -100)),
        "vpforce rhino": (rhino(), bytes([1, *range(33)])),
        "ffbeast": (ffbeast_pid(), struct.pack("<BIH", 1, 5, 40000)),
    }
    worst = 0.0
    for name, (descriptor, data) in reports.items():
        driver = PidDriver(descriptor)
        driver.begin(Answers())
        rest, wanted = build_unknown_controls(len(driver.axes)), force[: len(driver.forces)]
        read = microseconds(lambda d=driver, r=rest, b=data: d.decode(r, b))
        write = microseconds(lambda d=driver, w=wanted: d.encode(w, arm=False))
        arm = microseconds(lambda d=driver, w=wanted: d.encode(w, arm=True))
        worst = max(worst, read + arm)
        print(f"{name:24}{read:10.2f}{write:10.2f}{arm:10.2f}{read + arm:10.2f}")
    print(f"worst read and write together: {worst:.2f} us, allowed {LIMIT_US:.0f} us")


if __name__ == "__main__":
    main()
