"""Colours: a perceptually uniform scale of tension, and fixed colours of signals."""

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array

# viridis (S. van der Walt, N. Smith, 2015; CC0) at nine evenly spaced points, sRGB
_VIRIDIS = np.array(
    [
        (68, 1, 84), (71, 44, 122), (59, 81, 139), (44, 113, 142), (33, 145, 140),
        (39, 173, 129), (92, 200, 99), (170, 220, 50), (253, 231, 37),
    ],
    dtype=np.float64,
)  # fmt: skip
UNKNOWN = 0x808080FF  # grey: a tension that is not finite

# 0xRRGGBBAA, the same in scene and curves; mostly Okabe and Ito's, made for colour-blind eyes too
ESTIMATE, INTERVAL, TRUTH = 0x56B4E9FF, 0xA9D4EEFF, 0xE69F00FF
HAND, ASKED, HOUSING, FRONT = 0xCC79A7FF, 0x909090FF, 0x009E73FF, 0xFF4B4BFF
SECOND = 0xE5D86BFF  # the estimate of a joint's other tendon, in T(x)
BODY, ENVIRONMENT = 0xD8D8D8FF, 0xB4654ACC

# index into teleop.messages.PHASE_NAMES: slack, virgin, pull, pull to release, release, ...
PHASES = (0x606060FF, 0xF0F0F0FF, 0xD55E00FF, 0xF0E442FF, 0x0072B2FF, 0x4FD1C5FF)
# a session's states by name
STATES = {
    "off": 0x606060FF,
    "ready": 0x56B4E9FF,
    "engaged": 0x009E73FF,
    "clutched": 0xF0E442FF,
    "holding": 0xE69F00FF,
    "fault": 0xD55E00FF,
    "stopped": 0xFF2020FF,
}


def rgba(tension: Array, scale_N: float) -> NDArray[np.uint32]:
    """Return the colour of each tension as 0xRRGGBBAA, the shape kept.

    Dark violet is 0 N, yellow `scale_N`; lightness rises steadily between them, so the scale reads
    the same in grey and to most colour-blind eyes. Tensions outside are clipped.

    Parameters
    ----------
    tension : ndarray
        [N]
    scale_N : float
        [N] tension at the bright end.
    """
    place = np.nan_to_num(np.clip(tension / scale_N, 0.0, 1.0)) * (len(_VIRIDIS) - 1)
    knots = np.arange(len(_VIRIDIS))
    packed = np.full(np.shape(tension), 0xFF, np.uint32)
    for channel, shift in enumerate((24, 16, 8)):
        level = np.rint(np.interp(place, knots, _VIRIDIS[:, channel])).astype(np.uint32)
        packed |= level << np.uint32(shift)
    return np.where(np.isfinite(tension), packed, np.uint32(UNKNOWN)).astype(np.uint32)
