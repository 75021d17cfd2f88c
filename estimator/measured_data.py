"""What the mathematics needs of measured data: arrays with names, wherever they were read from."""

from typing import NamedTuple, Protocol

from estimator.array_types import Array
from estimator.units import LINEAR, Units


class MeasuredData(Protocol):
    """Samples of one tendon, arrays of shape (n,); None where there is no sensor.

    For a diagnosis, values other than times may be missing (NaN).
    `teleop.data.read_table` returns such data from a file, `Samples` holds arrays of your own.
    """

    @property
    def time(self) -> Array:
        """Sample times [s], strictly increasing."""

    @property
    def proximal_tension(self) -> Array:
        """Tension at the housing, T_in [N]."""

    @property
    def proximal_displacement(self) -> Array | None:
        """Travel at the housing, q_p [m], positive = pulled in."""

    @property
    def distal_tension(self) -> Array | None:
        """Tension at the tip, T_out [N], on a bench."""

    @property
    def distal_displacement(self) -> Array | None:
        """Travel of the tip, q_d [m], positive towards the housing."""


class Samples(NamedTuple):
    """Measured data in arrays of shape (n,); see `MeasuredData`."""

    time: Array
    proximal_tension: Array
    proximal_displacement: Array | None = None
    distal_tension: Array | None = None
    distal_displacement: Array | None = None
    units: Units = LINEAR  # ROTARY: torques [N m] and angles [rad] instead
