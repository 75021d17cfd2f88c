"""Llewellyn's criterion: whether a two-port is stable between any two passive ends.

It is, and only then, if at every frequency Re h11 >= 0, Re h22 >= 0 and

    eta = (2 Re h11 Re h22 - Re(h12 h21)) / |h12 h21| >= 1

(Llewellyn, "Some fundamental properties of transmission systems", Proc. IRE 40, 1952, 271-283;
Adams & Hannaford, "Stable haptic interaction with virtual environments", IEEE Trans. Robotics and
Automation 15, 1999, 465-474). It speaks of systems that are linear and do not change with time.
An ideal teleoperator has eta = 1.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from studies.transparency.hybrid import Hybrid


class Margin(NamedTuple):
    """Of each line."""

    eta: Array
    stable: NDArray[np.bool_]  # all three conditions hold


def margin(two_port: Hybrid) -> Margin:
    """Return the criterion's numbers at each line of a two-port."""
    h11, h12, h21, h22 = (r.value for r in two_port[1:])
    through = h12 * h21
    eta = (2.0 * h11.real * h22.real - through.real) / np.abs(through)
    return Margin(eta, (h11.real >= 0.0) & (h22.real >= 0.0) & (eta >= 1.0))
