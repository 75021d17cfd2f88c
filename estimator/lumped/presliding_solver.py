"""The balance of contacts that give before they slide: from the tip to the housing."""

from estimator.array_types import Array
from estimator.compiled import jit_borrow
from estimator.lumped.nodes import Tendon, Tip, compute_elongation, compute_tip_travel

_MAX_ITERATIONS = 60
_TRAVEL_TOLERANCE = 1e-11  # [m] of travel


@jit_borrow
def _propagate_from_tip(
    tendon: Tendon, tip: Tip, T_old: Array, lengths: Array, T_out: float, T_new: Array
) -> tuple[float, float, float]:
    """Go from the tip to the housing over contacts that give before they slide.

    Returns the travel of the motor [m], its slope by T_out, and that of T_in.
    """
    law = tendon.law
    last = len(T_old) - 1
    q_d, slope, _load = compute_tip_travel(tip, T_out)
    displacement = q_d - tip.q_old
    T_new[last] = T_out
    T, D = T_out, 1.0
    q_p, dq_p = q_d, slope
    for j in range(last - 1, -1, -1):
        elongation, elongation_slope = compute_elongation(tendon, j + 1, T)
        q_p += elongation + tendon.extra[j + 1]
        dq_p += elongation_slope * D
        displacement += elongation + tendon.extra[j + 1] - lengths[j + 1]
        slope += elongation_slope * D
        x, y = tendon.half_k[j], tendon.drag[j]
        r = law.asymmetry * x
        dashpot = 2.0 * x * law.viscosity / tendon.dt if tendon.dt > 0.0 else 0.0
        pull = (2.0 * x * T + y) / (1.0 - x)
        release = (2.0 * r * T + law.asymmetry * y) / (1.0 + r)
        if law.presliding_tension > 0.0:
            stiffness, stiffness_slope = 2.0 * x * law.presliding_tension / law.presliding, 0.0
        else:
            stiffness, stiffness_slope = pull / law.presliding, 2.0 * x / (1.0 - x) / law.presliding
        friction = T_old[j] - T_old[j + 1] + stiffness * displacement
        if friction > pull:
            T, D = (T + pull + dashpot * displacement, D * (1.0 + x) / (1.0 - x) + dashpot * slope)
        elif friction < -release:
            T = T - release + dashpot * displacement
            D = D * (1.0 - r) / (1.0 + r) + dashpot * slope
        else:
            T, D = (T + friction, D + stiffness * slope + stiffness_slope * D * displacement)
        if T < 0.0:
            T, D = 0.0, 0.0
        T_new[j] = T
    elongation, elongation_slope = compute_elongation(tendon, 0, T)
    return q_p + elongation + tendon.extra[0], dq_p + elongation_slope * D, D


@jit_borrow
def solve_presliding(
    tendon: Tendon,
    tip: Tip,
    T_old: Array,
    lengths: Array,
    target: float,
    forced: bool,
    T_new: Array,
) -> float:
    """Find the balance of contacts that give before they slide; return dq_p/dT_in [m/N]."""
    T = T_old[len(T_old) - 1]
    low, high = -1.0, 1e6
    q_p, dq_p, D = 0.0, 0.0, 1.0
    for _ in range(_MAX_ITERATIONS):
        q_p, dq_p, D = _propagate_from_tip(tendon, tip, T_old, lengths, T, T_new)
        excess, slope = (T_new[0] - target, D) if forced else (q_p - target, dq_p)
        if abs(excess) < _TRAVEL_TOLERANCE or (T == 0.0 and excess > 0.0):
            break
        if excess > 0.0:
            high = T
        else:
            low = T
        if high - low < 1e-13 * (1.0 + T):
            break
        candidate = max(T - excess / max(slope, 1e-18), 0.0)
        T = (
            candidate
            if low < candidate < high
            else 0.5 * (max(low, 0.0) + min(high, 2.0 * T + 10.0))
        )
    return dq_p / max(D, 1e-9)
