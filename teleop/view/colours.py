"""Colours: a perceptually uniform scale of tension, and fixed colours of signals."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array

# Nine evenly spaced points, sRGB: the hues of viridis (S. van der Walt, N. Smith, 2015; CC0), with
# CIE lightness from 50 to 91 in equal steps, as viridis begins too dark to be seen on BACKGROUND:
# the contrast (WCAG 2.2, 1.4.11) is 4.1 at 0 N, where viridis has 1.1.
TENSION_MAP = np.array(
    [
        (133, 99, 208), (115, 124, 219), (91, 147, 223), (66, 170, 208), (43, 191, 186),
        (86, 208, 148), (117, 223, 118), (184, 231, 61), (254, 231, 37),
    ],
    dtype=np.float64,
)  # fmt: skip
BACKGROUND = (18, 20, 24)
UNKNOWN = 0x808080FF  # grey: a tension that is not finite

# 0xRRGGBBAA, the same in scene and curves; mostly Okabe and Ito's, made for colour-blind eyes too
ESTIMATE, INTERVAL, TRUTH = 0x56B4E9FF, 0xA9D4EEFF, 0xE69F00FF
BAND = 0x1F4A63FF  # the certified interval as an area behind the estimate
HAND, COMMANDED, HOUSING, FRONT = 0xCC79A7FF, 0xA8A8A8FF, 0x00B583FF, 0xFF4B4BFF
SECOND = 0xE5D86BFF  # the estimate of a joint's other tendon, in T(x)
BODY, ENVIRONMENT = 0xD8D8D8FF, 0xB4654ACC
AXES = (0xF2705FFF, 0xB2DF6EFF, 0x6F9BFFFF)  # x, y, z of an arm, of different lightness too

# index into PHASE_NAMES: slack, virgin, pull, pull to release, release, ...
PHASES = (0x9A9A9AFF, 0xF0F0F0FF, 0xD55E00FF, 0xF0E442FF, 0x4A90FFFF, 0x4FD1C5FF)
# a session's states by name
STATES = {
    "off": 0x808080FF,
    "no data": 0x808080FF,
    "ready": 0x56B4E9FF,
    "engaged": 0x009E73FF,
    "clutched": 0xF0E442FF,
    "holding": 0xE69F00FF,
    "fault": 0xD55E00FF,
    "stopped": 0xFF2020FF,
}


def to_rgba(tension: Array, scale_N: float) -> NDArray[np.uint32]:
    """Return the colour of each tension as 0xRRGGBBAA, the shape kept.

    Violet is 0 N, yellow `scale_N`; lightness rises steadily between them, so the scale reads the
    same in grey and to most colour-blind eyes. Tensions outside are clipped.

    `tension` and `scale_N`, the bright end, are in N.
    """
    place = np.nan_to_num(np.clip(tension / scale_N, 0.0, 1.0)) * (len(TENSION_MAP) - 1)
    knots = np.arange(len(TENSION_MAP))
    packed = np.full(np.shape(tension), 0xFF, np.uint32)
    for channel, shift in enumerate((24, 16, 8)):
        level = np.rint(np.interp(place, knots, TENSION_MAP[:, channel])).astype(np.uint32)
        packed |= level << np.uint32(shift)
    return np.where(np.isfinite(tension), packed, np.uint32(UNKNOWN)).astype(np.uint32)


def darken_colour(colour: int, share: float) -> int:
    """Return a share of a colour 0xRRGGBBAA, the rest being `BACKGROUND`."""
    channels = zip(((colour >> shift) & 0xFF for shift in (24, 16, 8)), BACKGROUND, strict=True)
    red, green, blue = (round(share * own + (1.0 - share) * ground) for own, ground in channels)
    return red << 24 | green << 16 | blue << 8 | colour & 0xFF


def lighten_colour(colour: int) -> int:
    """Return a colour 0xRRGGBBAA half-way to white, for the second of two of a kind."""
    channels = [(colour >> shift) & 0xFF for shift in (24, 16, 8)]
    red, green, blue = ((channel + 0xFF) // 2 for channel in channels)
    return red << 24 | green << 16 | blue << 8 | colour & 0xFF


Rgb = tuple[float, float, float]


def to_rgb(colour: int) -> Rgb:
    """Return 0xRRGGBBAA as three shares."""
    red, green, blue = ((colour >> shift & 0xFF) / 255 for shift in (24, 16, 8))
    return red, green, blue


def compute_luminance(rgb: Sequence[float]) -> float:
    """Return the relative luminance of an sRGB colour, as WCAG defines it."""
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in rgb]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


PLAIN, LABEL = 0xF0F0F0FF, 0xC0C0C0FF  # of words and numbers, and of those at scales
# of a link by a word for it
QUALITIES = {"good": 0x4FD1A5FF, "poor": 0xF0E442FF, "bad": 0xFF6A4BFF, "none": 0xFF6A4BFF}
_NEAR_LIMIT_SHARE = 0.8  # share of the limit from which a force is shown as near to it


def choose_force_colour(share: float) -> int:
    """Return the colour of a force that is `share` of its limit: calm, near to it, beyond."""
    size = abs(share)
    return ESTIMATE if size < _NEAR_LIMIT_SHARE else QUALITIES["poor" if size < 1.0 else "bad"]
