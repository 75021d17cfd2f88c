"""The tension profile along the sheath, a play operator: the transmission's memory and its update.

With y(s) = ln(T + tau) over the friction coordinate s, sliding towards the motor gives dy/ds = -1,
sliding towards the tip dy/ds = +rho, and what sticks keeps what it had. Driven from the housing to
u = ln(T_in + tau), or from the tip to u_d = ln(T_out + tau), the profile becomes

    (T10)  y = min(max(y_old, u - s), u + rho s)
    (T18)  y = min(max(y_old, u_d - rho (K - s)), u_d + (K - s))

so it stays piecewise linear: a row of break points, one for each reversal not yet wiped out,
that both ends work on as on a stack. A sample adds at most one point and every point is removed at
most once: the cost is O(1) per sample over a history.

A `Profile` is one flat array, so that it copies in one move and passes into compiled code as is. It
holds at most `CAPACITY` break points; see `get_merge_error_bound` for what happens beyond. The push
functions advance it in place and leave it as it was when handed a number that is not finite.
"""

import math
from typing import TypeAlias, cast

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.law import tables as _tables
from estimator.law.sheath import SheathError
from estimator.law.tables import Tables, integrate_exponential

Profile: TypeAlias = Array

CAPACITY = 128
"""Break points a profile can hold; a power of two, the points being a ring."""

FLOOR = 1e-9
"""Least tension [N] inside a logarithm; slack is the floor."""

# of numpy: numba compiles a function anew for each whole number of Python that it is called with
HOUSING, TIP = cast(int, np.int64(1)), cast(int, np.int64(-1))
"""The end that is driven, as the direction in which its front travels."""

_MASK = CAPACITY - 1
_HEAD, _COUNT, _AREA_SUM, _MERGE_ERROR = range(4)
_S = 4
_Y = _S + CAPACITY
_SLOPE = _Y + CAPACITY  # of the piece from this point to the next
_AREA = _SLOPE + CAPACITY  # ∫ (T + tau) dx over that piece [N m]
PROFILE_SIZE = _AREA + CAPACITY

_K, _DRAG = _tables.K, _tables.DRAG
_ASYMMETRY, _FIRST_LENGTH = _tables.ASYMMETRY, _tables.FIRST_LENGTH


def build_pretensioned_profile(tables: Tables, tension: float) -> Profile:
    """Return the profile of a tendon at one and the same `tension` [N], never yet slid."""
    if not (0.0 <= tension < math.inf):
        raise SheathError(f"pretension: {tension} N, must be finite and not negative")
    profile = np.zeros(PROFILE_SIZE)
    u = to_log_tension(tables, tension)
    profile[_COUNT] = 2.0
    profile[_S + 1] = tables[_K]
    profile[_Y] = profile[_Y + 1] = u
    profile[_AREA] = profile[_AREA_SUM] = integrate_line(tables, 0.0, u, float(tables[_K]), 0.0)
    return profile


def build_slack_profile(tables: Tables) -> Profile:
    """Return the profile of a slack tendon; the first pull from it is fully mobilised."""
    return build_pretensioned_profile(tables, 0.0)


@jit_compile
def to_log_tension(tables: Tables, tension: float) -> float:
    """Return u = ln(T + tau), a tension [N] below zero counting as slack."""
    shifted: float = max(tension, 0.0) + tables[_DRAG]
    return math.log(max(shifted, FLOOR))


@jit_compile
def from_log_tension(tables: Tables, y: float) -> float:
    """Return T = e^y - tau [N], not below zero."""
    tension: float = math.exp(y) - tables[_DRAG]
    return max(tension, 0.0)


@jit_compile
def count_points(profile: Profile) -> int:
    """Return the number of break points, both ends included."""
    return int(profile[_COUNT])


@jit_compile
def get_point(profile: Profile, index: int) -> tuple[float, float, float]:
    """Return (s, y, slope of the piece that follows) of break point `index`, housing first."""
    k = (int(profile[_HEAD]) + index) & _MASK
    return profile[_S + k], profile[_Y + k], profile[_SLOPE + k]


@jit_compile
def find_extremes(profile: Profile, depth: float) -> tuple[float, float]:
    """Return the least and the largest y from a friction `depth` to the tip."""
    k = count_points(profile) - 1
    s, y, _ = get_point(profile, k)
    low = high = y
    while s > depth and k > 0:
        k -= 1
        s, y, slope = get_point(profile, k)
        y += slope * max(depth - s, 0.0)
        low, high = min(low, y), max(high, y)
    return low, high


@jit_compile
def get_piece_integral(profile: Profile, index: int) -> float:
    """Return ∫ (T + tau) dx over the piece that follows break point `index` [N m]."""
    area: float = profile[_AREA + ((int(profile[_HEAD]) + index) & _MASK)]
    return area


@jit_compile
def integrate_line(tables: Tables, s_a: float, y_a: float, s_b: float, slope: float) -> float:
    """Return ∫ e^y dx over (s_a, s_b] for the line of `slope` through (s_a, y_a) [N m] (T14)."""
    scale = math.exp(y_a - slope * s_a)
    return scale * (
        integrate_exponential(tables, s_b, slope) - integrate_exponential(tables, s_a, slope)
    )


@jit_compile
def get_merge_error_bound(profile: Profile) -> float:
    """Return how far |ln T| may be off anywhere because the profile ran full.

    When `CAPACITY` points do not suffice, the two neighbouring pieces that cost least change places
    and melt into their neighbours. That moves y nowhere by more than (1 + rho) times the shorter of
    the two, hence at most by (1 + rho) K/(CAPACITY - 6); the end tensions stay exact. These bounds
    add up here until a full swing wipes the profile clean. The law never enlarges a difference of
    profiles, so the sum bounds the relative error of T_out and of T(x) for good.
    """
    bound: float = profile[_MERGE_ERROR]
    return bound


@jit_compile
def integrate_tension(tables: Tables, profile: Profile) -> float:
    """Return ∫ (T + tau) dx over the sheath [N m]."""
    y_in = profile[_Y + (int(profile[_HEAD]) & _MASK)]
    area: float = profile[_AREA_SUM] + tables[_FIRST_LENGTH] * math.exp(y_in)
    return area


@jit_compile
def drive_end(tables: Tables, profile: Profile, u: float, end: int) -> None:
    """Drive one `end` to the log tension `u`, in place: (T10) from HOUSING, (T18) from TIP."""
    head, count = int(profile[_HEAD]), int(profile[_COUNT])
    end_point = head if end > 0 else head + count - 1
    rise = u - profile[_Y + (end_point & _MASK)]
    if rise == 0.0:
        return
    sign = 1.0 if rise > 0.0 else -1.0
    slope = -1.0 if sign * end > 0.0 else tables[_ASYMMETRY]
    s_end = 0.0 if end > 0 else tables[_K]
    s_far = tables[_K] - s_end
    intercept = u - slope * s_end
    join = end_point
    area_sum = profile[_AREA_SUM]
    mobilised = True
    while count > 1:
        next_point = join + end
        a, b = join & _MASK, next_point & _MASK
        piece = a if end > 0 else b
        s_b, y_b, m = profile[_S + b], profile[_Y + b], profile[_SLOPE + piece]
        area_sum -= profile[_AREA + piece]
        if m == slope or sign * (intercept + slope * s_b - y_b) >= 0.0:
            join = next_point
            count -= 1
            continue
        s = (intercept - y_b + m * s_b) / (m - slope)
        s_a = profile[_S + a]
        s = min(max(s, min(s_a, s_b)), max(s_a, s_b))
        y = intercept + slope * s
        profile[_S + a], profile[_Y + a] = s, y
        area = (
            integrate_line(tables, s, y, s_b, m)
            if end > 0
            else integrate_line(tables, s_b, y_b, s, m)
        )
        profile[_AREA + piece] = area
        area_sum += area
        mobilised = False
        break
    if mobilised:
        profile[_S + (join & _MASK)] = s_far
        profile[_Y + (join & _MASK)] = intercept + slope * s_far
        profile[_MERGE_ERROR] = 0.0
        area_sum = 0.0  # ends the rounding that a running sum gathers
    new = join - end
    k = new & _MASK
    piece = k if end > 0 else join & _MASK
    s_join, y_join = profile[_S + (join & _MASK)], profile[_Y + (join & _MASK)]
    profile[_S + k], profile[_Y + k], profile[_SLOPE + piece] = s_end, u, slope
    if end > 0:
        area = integrate_line(tables, s_end, u, s_join, slope)
        head = new
    else:
        area = integrate_line(tables, s_join, y_join, s_end, slope)
    profile[_AREA + piece] = area
    profile[_HEAD], profile[_COUNT] = float(head & _MASK), float(count + 1)
    profile[_AREA_SUM] = area_sum + area
    if count + 1 == CAPACITY:
        _merge_smallest_pieces(tables, profile)


@jit_compile
def push_proximal(tables: Tables, profile: Profile, tension: float) -> None:
    """Bring T_in to `tension` [N] by the motor, in place (T10)."""
    if math.isfinite(tension):
        drive_end(tables, profile, to_log_tension(tables, tension), HOUSING)


@jit_compile
def push_distal(tables: Tables, profile: Profile, tension: float) -> None:
    """Bring T_out to `tension` [N] by the load or the environment, in place (T18)."""
    if math.isfinite(tension):
        drive_end(tables, profile, to_log_tension(tables, tension), TIP)


@jit_compile
def resize_profile(tables: Tables, profile: Profile, y_tip: float) -> None:
    """Fit a profile to `tables` of another friction, in place; the tension at each depth stays.

    A profile that was shorter is continued by that of the slopes -1, 0, rho which leads closest to
    the log tension `y_tip` at the tip.
    """
    K, head = tables[_K], int(profile[_HEAD])
    count = int(profile[_COUNT])
    while count > 2 and get_point(profile, count - 2)[0] >= K:
        count -= 1
    s_a, y_a, slope = get_point(profile, count - 2)
    end = (head + count - 1) & _MASK
    s_b, y_b = profile[_S + end], profile[_Y + end]
    if s_b < K:
        rho = tables[_ASYMMETRY]
        m = (y_tip - y_b) / (K - s_b)
        m = -1.0 if m < -0.5 else rho if m > 0.5 * rho else 0.0
        if m != slope and count < CAPACITY - 1:
            profile[_SLOPE + end] = m
            s_a, y_a, slope = s_b, y_b, m
            count, end = count + 1, (end + 1) & _MASK
    profile[_S + end], profile[_Y + end] = K, y_a + slope * (K - s_a)
    profile[_COUNT] = float(count)
    profile[_AREA_SUM] = 0.0
    for k in range(count - 1):
        s, y, m = get_point(profile, k)
        area = integrate_line(tables, s, y, get_point(profile, k + 1)[0], m)
        profile[_AREA + ((head + k) & _MASK)] = area
        profile[_AREA_SUM] += area


@jit_compile
def _merge_smallest_pieces(tables: Tables, profile: Profile) -> None:
    """Make room for two points at the least cost in |ln T|; see `get_merge_error_bound`."""
    head, count = int(profile[_HEAD]), int(profile[_COUNT])
    best, cost = -1, math.inf
    for k in range(1, count - 3):
        s_a, _, m_a = get_point(profile, k)
        s_b, _, m_b = get_point(profile, k + 1)
        s_c, _, m_c = get_point(profile, k + 2)
        if get_point(profile, k - 1)[2] != m_b or m_c != m_a:
            continue
        change = abs(m_a - m_b) * min(s_b - s_a, s_c - s_b)
        if change < cost:
            best, cost = k, change
    s_a, y_a, _ = get_point(profile, best)
    s_b, _, m = get_point(profile, best + 1)
    s_c, _, m_last = get_point(profile, best + 2)
    s_before, y_before, _ = get_point(profile, best - 1)
    s_after, _, _ = get_point(profile, best + 3)
    previous, middle = (head + best - 1) & _MASK, (head + best) & _MASK
    for k in range(best - 1, best + 3):
        profile[_AREA_SUM] -= profile[_AREA + ((head + k) & _MASK)]
    s, y = s_a + (s_c - s_b), y_a + m * (s_c - s_b)
    profile[_S + middle], profile[_Y + middle], profile[_SLOPE + middle] = s, y, m_last
    profile[_AREA + previous] = integrate_line(tables, s_before, y_before, s, m)
    profile[_AREA + middle] = integrate_line(tables, s, y, s_after, m_last)
    profile[_AREA_SUM] += profile[_AREA + previous] + profile[_AREA + middle]
    for k in range(best + 1, count - 2):
        source, target = (head + k + 2) & _MASK, (head + k) & _MASK
        for column in (_S, _Y, _SLOPE, _AREA):
            profile[column + target] = profile[column + source]
    profile[_COUNT] = float(count - 2)
    profile[_MERGE_ERROR] += cost
