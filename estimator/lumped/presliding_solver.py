"""The balance of contacts that give before they slide: from the tip to the housing."""

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.lumped.nodes import Tendon, Tip, compute_elongation, compute_tip_travel

_MAX_ITERATIONS = 60
_TRAVEL_TOLERANCE = 1e-11  # [m] of travel


@jit_compile
def _propagate_from_tip(
    tendon: Tendon, tip: Tip, before: Array, lengths: Array, T_out: float, after: Array
) -> tuple[float, float, float]:
    """Go from the tip to the housing over contacts that give before they slide.

    Returns the travel of the motor [m], its slope by T_out, and that of T_in.
    """
    law = tendon.law
    last = len(before) - 1
    q_d, by, _load = compute_tip_travel(tip, T_out)
    moved = q_d - tip.before
    after[last] = T_out
    T, D = T_out, 1.0
    q_p, dq_p = q_d, by
    for j in range(last - 1, -1, -1):
        part, part_by = compute_elongation(tendon, j + 1, T)
        q_p += part + tendon.kept[j + 1]
        dq_p += part_by * D
        moved += part + tendon.kept[j + 1] - lengths[j + 1]
        by += part_by * D
        x, y = tendon.half[j], tendon.drag[j]
        r = law.asymmetry * x
        dashpot = 2.0 * x * law.viscosity / tendon.dt if tendon.dt > 0.0 else 0.0
        pull = (2.0 * x * T + y) / (1.0 - x)
        release = (2.0 * r * T + law.asymmetry * y) / (1.0 + r)
        if law.give_tension > 0.0:
            stiff, stiff_by = 2.0 * x * law.give_tension / law.give, 0.0
        else:
            stiff, stiff_by = pull / law.give, 2.0 * x / (1.0 - x) / law.give
        friction = before[j] - before[j + 1] + stiff * moved
        if friction > pull:
            T, D = T + pull + dashpot * moved, D * (1.0 + x) / (1.0 - x) + dashpot * by
        elif friction < -release:
            T, D = T - release + dashpot * moved, D * (1.0 - r) / (1.0 + r) + dashpot * by
        else:
            T, D = T + friction, D + stiff * by + stiff_by * D * moved
        if T < 0.0:
            T, D = 0.0, 0.0
        after[j] = T
    part, part_by = compute_elongation(tendon, 0, T)
    return q_p + part + tendon.kept[0], dq_p + part_by * D, D


@jit_compile
def solve_presliding(
    tendon: Tendon,
    tip: Tip,
    before: Array,
    lengths: Array,
    target: float,
    forced: bool,
    after: Array,
) -> float:
    """Find the balance of contacts that give before they slide; return dq_p/dT_in [m/N]."""
    T = before[len(before) - 1]
    low, high = -1.0, 1e6
    q_p, dq_p, D = 0.0, 0.0, 1.0
    for _ in range(_MAX_ITERATIONS):
        q_p, dq_p, D = _propagate_from_tip(tendon, tip, before, lengths, T, after)
        over, by = (after[0] - target, D) if forced else (q_p - target, dq_p)
        if abs(over) < _TRAVEL_TOLERANCE or (T == 0.0 and over > 0.0):
            break
        if over > 0.0:
            high = T
        else:
            low = T
        if high - low < 1e-13 * (1.0 + T):
            break
        guess = max(T - over / max(by, 1e-18), 0.0)
        T = guess if low < guess < high else 0.5 * (max(low, 0.0) + min(high, 2.0 * T + 10.0))
    return dq_p / max(D, 1e-9)
