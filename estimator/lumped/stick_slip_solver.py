"""The balance of contacts that stick or slide: all of a tendon in one step, implicit in time."""

from estimator.array_types import Array
from estimator.compiled import compiled
from estimator.lumped.nodes import Tendon, Tip, elongation, tip_travel

ROWS = 6
"""Rows of a node each that `slide` works with."""


@compiled
def slide(
    tendon: Tendon,
    tip: Tip,
    before: Array,
    lengths: Array,
    target: float,
    forced: bool,
    after: Array,
    sliding: Array,
    slid: Array,
    work: Array,
) -> tuple[bool, float]:
    """Find the balance of contacts that stick or slide, by how far each of them slides.

    Each contact is guessed to stick or to slide one way (`sliding`, kept from the sample before),
    the balance of all is solved, and guesses that Coulomb contradicts are put right until none is
    left. The housing's end is at `target`, a tension [N] if `forced`, else a travel [m].

    Returns whether that came to an end, and dq_p/dT_in [m/N]; fills `slid` [m].
    """
    last = len(before) - 1
    law, half, drag, kept, scale = tendon.law, tendon.half, tendon.drag, tendon.kept, tendon.scale
    upper, right, pivot = work[0], work[1], work[2]
    slope, stiff, zero = work[3], work[4], work[5]  # of each node, linear about `after`
    rho, dashpot = law.asymmetry, 2.0 * law.viscosity / tendon.dt if tendon.dt > 0.0 else 0.0
    curved = law.toe != 0.0 or law.compression != 0.0
    held = tip.before
    for j in range(last + 1):
        held += lengths[j]
        after[j] = before[j]
        slope[j] = scale * tendon.weights[j]
        stiff[j] = 1.0 / slope[j]
        zero[j] = (lengths[j] - kept[j]) * stiff[j]
    moved = target - held
    loose, T_in = forced, target if forced else 0.0
    ended, dq = False, 0.0
    free_slope, free_zero = slope[last], zero[last]  # of the last node without what it pulls at
    for _ in range(6 * last):
        if curved:
            for j in range(last + 1):
                longer, slope[j] = elongation(tendon, j, after[j])
                stiff[j] = 1.0 / slope[j]
                zero[j] = after[j] - (longer + kept[j] - lengths[j]) * stiff[j]
            free_slope, free_zero = slope[last], zero[last]
        q, dq, _load = tip_travel(tip, after[last])
        known = q - dq * after[last] - tip.before
        slope[last] = free_slope + dq
        stiff[last] = 1.0 / slope[last]
        zero[last] = (free_slope * free_zero - known) * stiff[last]
        for j in range(last):  # A T_before - B T_after - g slid = c, tridiagonal in what slid
            if sliding[j] == 0.0:
                upper[j], right[j], pivot[j] = 0.0, 0.0, 1.0
                continue
            x = half[j]
            A, B, c, g = 1.0 - x, 1.0 + x, drag[j], x * dashpot
            if sliding[j] < 0.0:
                A, B, c, g = 1.0 + rho * x, 1.0 - rho * x, -rho * c, rho * g
            lower, upper[j] = A * stiff[j], B * stiff[j + 1]
            diagonal = -lower - upper[j] - g
            right[j] = c - A * zero[j] + B * zero[j + 1]
            if j > 0:
                factor = lower * pivot[j - 1]
                diagonal -= factor * upper[j - 1]
                right[j] -= factor * right[j - 1]
            elif loose:
                diagonal += lower
                right[0] += A * (zero[0] - T_in)
            else:
                right[0] -= lower * moved
            pivot[j] = 1.0 / diagonal
        ahead = 0.0
        for j in range(last - 1, -1, -1):
            ahead = (right[j] - upper[j] * ahead) * pivot[j]
            slid[j] = ahead
        ended = True
        change = 0.0
        into = moved
        for j in range(last + 1):
            out = 0.0 if j == last else slid[j]
            T = T_in if j == 0 and loose else zero[j] + (into - out) * stiff[j]
            change = max(change, abs(T - after[j]))
            after[j], into = T, out
        if (curved or tip.low != tip.high) and change > 1e-9:
            ended = False
        for j in range(last):
            total, drop = max(after[j] + after[j + 1], 0.0), after[j] - after[j + 1]
            if sliding[j] == 0.0:
                room = 1e-10 * (1.0 + total)
                friction = half[j] * total + drag[j]
                if drop > friction + room:
                    sliding[j], ended = 1.0, False
                elif drop < -rho * friction - room:
                    sliding[j], ended = -1.0, False
            elif sliding[j] * slid[j] < -1e-16:
                sliding[j], ended = 0.0, False
        if ended and not loose and after[0] < 0.0:  # slack: its end goes where it likes
            loose, T_in, ended = True, 0.0, False
        if ended:
            break
    reach, D = 0.0, 1.0
    for j in range(last + 1):
        after[j] = max(after[j], 0.0)
        reach += D * slope[j]
        if j < last and sliding[j] != 0.0:
            x = half[j] if sliding[j] > 0.0 else -rho * half[j]
            D *= (1.0 - x) / (1.0 + x)
        else:
            D = 0.0
    return ended, reach
