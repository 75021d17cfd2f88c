"""The motor driven by travel instead of tension: the T_in that goes with a displacement.

With the tip held, q_p - q_d = e (T17), and the elongation rises strictly with T_in, so there is one
root. Between two break points e is the integral of known exponentials, and the front's depth is
the unknown: the walk over the break points is exact, the last step on a uniform curve is (T16),
and the same safeguarded iteration serves any curvature.
"""

import math

from estimator.compiled import jit_compile
from estimator.law import tables as _tables
from estimator.law.play_profile import (
    FLOOR,
    HOUSING,
    Profile,
    count_points,
    drive_end,
    get_piece_integral,
    get_point,
    integrate_line,
    integrate_tension,
    to_log_tension,
)
from estimator.law.tables import Tables, compute_length_density, integrate_exponential

# Targets closer than this, relative to the present one, are the same: without it rounding would
# plant a reversal at every sample while the motor holds.
_RELATIVE_TOLERANCE = 1e-13
_ROOT_ITERATIONS = 60

_K, _LENGTH, _EA = _tables.K, _tables.LENGTH, _tables.EA
_DRAG, _ASYMMETRY = _tables.DRAG, _tables.ASYMMETRY


@jit_compile
def push_displacement(tables: Tables, profile: Profile, displacement: float, q_d: float) -> None:
    """Bring the motor to `displacement` q_p [m] with the tip held at `q_d` [m], in place.

    T_in becomes the tension whose elongation is q_p - q_d (T17), slack if that is not positive.
    Both travels are positive towards the motor and zero where the slack tendon starts to stretch.
    """
    target = (displacement - q_d) * tables[_EA] + tables[_DRAG] * tables[_LENGTH]
    if math.isfinite(target):
        drive_end(tables, profile, _solve_log_tension(tables, profile, target, 0.0), HOUSING)


@jit_compile
def push_displacement_spring(
    tables: Tables, profile: Profile, displacement: float, q_0: float, stiffness: float
) -> None:
    """Bring the motor to `displacement` [m] against a spring at the tip, in place.

    The tip obeys T_out = k (q_d - q_0) and never pushes: below `q_0` [m] it is slack. The spring is
    compliance in series that the whole tendon must slide to reach; `stiffness` k [N/m] is positive.
    """
    series = tables[_EA] / stiffness
    target = (displacement - q_0) * tables[_EA] + tables[_DRAG] * (tables[_LENGTH] + series)
    if math.isfinite(target):
        drive_end(tables, profile, _solve_log_tension(tables, profile, target, series), HOUSING)


@jit_compile
def _solve_log_tension(tables: Tables, profile: Profile, target: float, series: float) -> float:
    """Return the u at which ∫ (T + tau) dx + series (T_out + tau) is `target` [N m].

    The integral rises strictly with T_in. Walk the break points the front would pass; the root lies
    on the first piece whose far end is beyond the target, or in full sliding, where it is explicit.
    """
    count = count_points(profile)
    _, y_in, _ = get_point(profile, 0)
    _, y_out, _ = get_point(profile, count - 1)
    tip = series * math.exp(y_out)
    integral = integrate_tension(tables, profile) + tip
    if abs(target - integral) <= _RELATIVE_TOLERANCE * integral:
        return y_in
    lowest = to_log_tension(tables, 0.0)
    sign = 1.0 if target > integral else -1.0
    slope = -1.0 if sign > 0.0 else tables[_ASYMMETRY]
    excess = integral - integrate_exponential(tables, 0.0, 0.0) * math.exp(y_in)
    for index in range(count - 1):
        excess -= get_piece_integral(profile, index)
        s_a, _, m = get_point(profile, index)
        s_b, y_b, _ = get_point(profile, index + 1)
        if m == slope:
            continue
        at_b = math.exp(y_b - slope * s_b) * integrate_exponential(tables, s_b, slope) + excess
        if sign * (target - at_b) < 0.0:
            s = _solve_front(tables, s_a, s_b, y_b, m, slope, target - excess)
            u = y_b + m * (s - s_b) - slope * s
            return max(u, lowest)
    per_tension = integrate_exponential(tables, tables[_K], slope) + series * math.exp(
        slope * tables[_K]
    )
    return max(math.log(max(target / per_tension, FLOOR)), lowest)


@jit_compile
def _solve_front(
    tables: Tables, s_a: float, s_b: float, y_b: float, m: float, slope: float, target: float
) -> float:
    """Return the front s in [s_a, s_b] up to which ∫ (T + tau) dx over [0, s_b] is `target`.

    Newton with curvature, kept in a bracket: at a reversal the integral grows with the square of
    the front's depth, which a parabola follows and a tangent does not.
    """
    low, high = s_a, s_b
    sign = 1.0 if m > slope else -1.0
    s = s_a
    for _ in range(_ROOT_ITERATIONS):
        y = y_b + m * (s - s_b)
        tension = math.exp(y - slope * s)
        depth = integrate_exponential(tables, s, slope)
        excess = tension * depth + integrate_line(tables, s, y, s_b, m) - target
        if sign * excess < 0.0:
            low = s
        else:
            high = s
        first = (m - slope) * tension * depth
        second = (m - slope) * (first + math.exp(y) * compute_length_density(tables, s))
        root = first * first - 2.0 * excess * second
        step = math.nan
        if root >= 0.0:
            step = -2.0 * excess / (first + math.copysign(math.sqrt(root), first))
        if not low <= s + step <= high:
            step = 0.5 * (low + high) - s
        s += step
        if abs(step) <= 1e-15 * s_b:
            break
    return s
