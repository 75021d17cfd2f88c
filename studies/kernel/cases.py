"""The devices of the kernel run: what the hand does to each, and what is written to it."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

from studies.hid.virtual.catalogue import DEVICES
from studies.hid.virtual.device import VirtualDevice

Shares = tuple[float, ...]

_WAY = 1999  # positions before the hand begins anew
REPORT_S = 0.001  # [s] every device reports this often here, the slow ones, too


class Case(NamedTuple):
    """One device.

    `inputs` and `forces` name its axes in the order in which the virtual device has them; `signs`
    are those of its firmware, of which the driver cannot know.
    """

    name: str
    driver: str
    kernel: str  # the kernel's driver that binds it
    inputs: tuple[str, ...]
    one_sided: tuple[str, ...] = ()
    forces: tuple[str, ...] = ()
    signs: tuple[int, ...] = ()
    force: Callable[[int], Shares] = lambda _n: ()
    centres: bool = False  # by itself, from power on until the driver begins
    counts: int = 32767  # of an input from the middle to the end; a decoded share is that exact

    def build_device(self) -> VirtualDevice:
        """Return it as it is at power on."""
        device = DEVICES[self.name]()
        device.interval = REPORT_S
        return device

    def place_hand(self, n: int) -> Shares:
        """Return where the hand has moved the axes at report number `n`."""
        return _build_ways(self.inputs, self.one_sided)[n % _WAY]


@cache
def _build_ways(inputs: tuple[str, ...], one_sided: tuple[str, ...]) -> list[Shares]:
    """Return a way of the hand that is nowhere the same twice."""
    return [
        tuple(
            abs(share) if name in one_sided else share
            for k, name in enumerate(inputs)
            for share in [((n * (31 + 22 * k)) % _WAY - _WAY // 2) / (_WAY // 2)]
        )
        for n in range(_WAY)
    ]


def _compute_pushes(n: int) -> Shares:
    return ((n * 37) % 199 - 99) / 110, ((n * 51) % 199 - 99) / 110


def _compute_one_push(n: int) -> Shares:
    return _compute_pushes(n)[:1]


def _compute_resistances(n: int) -> Shares:
    return -(n % 8 + 1) / 8, -(3 * n % 8 + 1) / 8


_XY = ("x", "y")

CASES = (
    Case("openffboard", "pid", "hid-generic", _XY, (), _XY, (1, 1), _compute_pushes),
    Case("openffboard-wheel", "pid", "hid-generic", ("x",), (), ("x",), (1,), _compute_one_push),
    Case("arduino", "pid", "hid-generic", _XY, (), _XY, (-1, -1), _compute_pushes),
    Case("sidewinder", "pid", "hid-generic", _XY, (), _XY, (-1, -1), _compute_pushes, centres=True),
    Case("rhino", "pid", "hid-generic", _XY, (), _XY, (1, 1), _compute_pushes, counts=4096),
    Case(
        "dualsense",
        "dualsense",
        "playstation",
        ("lx", "ly", "rx", "ry", "l2", "r2"),
        ("l2", "r2"),
        ("l2", "r2"),
        (1, 1),
        _compute_resistances,
        counts=127,
    ),
    Case("spacemouse", "spacemouse", "hid-generic", ("x", "y", "z", "rx", "ry", "rz"), counts=350),
)
