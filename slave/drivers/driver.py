"""The driver interface: one bus with motors and load cells, used by the process of its own.

A driver works in the units of its bus, whole counts; directions, pulleys, zeros and scales belong
to `slave.rigs.hardware`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Counts = NDArray[np.float64]
"""Values in counts of the bus; NaN if missing."""


class DriverFault(Exception):
    """A failure of bus, motors or load cells; the message names the place and the reason."""


@dataclass(frozen=True, slots=True)
class Channels:
    """Addresses of the motors and load cells that a rig uses on one bus, and how."""

    motors: tuple[int, ...] = ()
    cells: tuple[int, ...] = ()
    read_only: bool = False  # nothing is written to them, no motor is enabled or disabled


@dataclass(frozen=True, slots=True)
class BusReading:
    """What the bus told at one time."""

    time_s: float  # [s] machine's monotonic clock, when it was sampled
    position: Counts  # shape (motors,)
    cell: Counts  # shape (cells,)
    follows: bool = False  # whether every motor is enabled and follows the targets


class BusDriver(Protocol):
    """One bus, used from one thread: `start`, any number of `run_cycle` and `stop`, `close`.

    `start` and `run_cycle` raise `DriverFault`; then only `close` is called. A driver moves nothing
    before the first target, and enables its motors where they are.
    """

    period_s: float  # between two cycles; 0 if `run_cycle` waits for the bus itself

    def start(self) -> None:
        """Open the bus, set up and check what is on it, watchdogs of the motors included."""

    def run_cycle(self, target: Counts | None) -> Sequence[BusReading]:
        """Exchange values once; return the new readings, oldest first.

        Waits for the bus, less than a third of the motors' watchdog. The newest targets, shape
        (motors,), are None before the first one and after `stop`: the motors stay disabled.
        """

    def stop(self) -> None:
        """Emergency stop by the motors' own means; the next target enables them again.

        A cycle without a target follows at once.
        """

    def summarise(self) -> dict[str, int | float | str]:
        """Return the driver's entries for the summary, lost frames for example."""

    def close(self) -> None:
        """Stop the motors, release the bus; never raises, also before `start`."""
