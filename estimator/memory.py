"""What the online estimator remembers of one tendon, as one flat array, and where in it.

First the scalars, then the tension profile (estimator.profile), then the profile as it was at the
anchor of the window of evidence; of an extended model then what is run beside the law
(estimator.beyond) and a number for each reading that is put right. One array copies in one move,
which keeps `online.step` pure.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimator.profile import PROFILE_SIZE

Array = NDArray[np.float64]
State: TypeAlias = NDArray[np.float64]

TENSION_FLOOR = 1e-3
"""Least noise [N] the decisions reckon with, however good the load cell is said to be."""

DISPLACEMENT_FLOOR = 2e-7
"""Least noise [m] the decisions reckon with: an encoder has counts."""

BOUND = 4.0
"""Sigma that bound a single reading."""

# Where the constants of a prepared model are
SIGMA_T, SIGMA_Q, TAU, BAND, K_ERROR, E_ERROR, RATE = range(7)
CONSTANTS = 7

# Where the scalars of the state are
(
    STARTED,  # a sample has been taken
    JOINED,  # the previous sample had a displacement, so increments mean something
    MEAN_T,  # [N] averaged tension
    VARIANCE,  # [N^2] of the averaged tension
    MEAN_Q,  # [m] averaged displacement, with the same lag
    HELD,  # [N] treated tension, which drives the profile
    HEADING,  # sign of the last change of the treated tension
    T_LEAST,  # [N] extremes of the treated tension since the start
    T_MOST,
    PLACE,  # [m] displacement behind a dead band, which tells where the motor turned
    PLACE_HEADING,  # sign of its last change
    ANCHOR_T,  # [N] where the window of evidence began
    ANCHOR_Q,  # [m]
    ANCHOR_E,  # [m] elongation of the profile there
    ANCHOR_AGE,  # [s]
    DRIVER,  # 0 the motor, 1 the tip
    WINDOW_T,  # [N] where the window of proof began
    WINDOW_Q,  # [m]
    WINDOW_AGE,  # [s]
    WINDOW_T_LEAST,  # [N]
    WINDOW_T_MOST,
    PROVED_LOW,  # [N] T_out as proved by motion and aged since
    PROVED_HIGH,
    LOW,  # [N] the interval last reported
    HIGH,
    SCALARS,
) = range(26)

MEMORY = SCALARS + PROFILE_SIZE
"""Where the profile at the anchor lies, behind the present one."""

BESIDE = MEMORY + PROFILE_SIZE
"""Where what an extended model remembers lies, behind what the law does."""
