"""The transmission with everything that real ones add to the paper's law, on nodes of bend angle.

`estimator.transmission` has the law in closed form; what is here has none: friction that depends on
speed, tension, time or direction, elasticity that is not linear or takes time, and a tip tied to
something. The tendon is a row of springs with contacts between them, evenly spread over the bend
angle. In a step each contact sticks or slides, and by how far is solved for all of them together,
implicit in time (docs/theory.md (T1), section 8); contacts that give before they slide are solved
from the tip to the housing. At its neutral values `Physics` is the law of `estimator.transmission`.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled

Array = NDArray[np.float64]

NODES = 41
"""Nodes from housing to tip."""

_GRADED = 2.5
PLACES = np.expm1(_GRADED * np.linspace(0.0, 1.0, NODES)) / math.expm1(_GRADED)
"""Where nodes are, shares of K: close at the housing, where every reversal begins."""

EDGES = np.concatenate([[0.0], 0.5 * (PLACES[:-1] + PLACES[1:]), [1.0]])
"""Where the stretch of tendon that counts to a node ends and the next begins, shares of K."""

_ROUNDS = 60
_ENOUGH = 1e-11  # [m] of travel
_SMALLEST = 1.0 / 8.0  # of a step
_SMOOTH = 0.05  # of K, that friction never falls below, however far a fit is carried on
_PIECE = 0.5  # of a sample: contacts that let go as they slide do so within it
_STEEPEST = 0.45  # half the friction between two nodes, at most; beyond it nothing would pass
_STIFF = 1e12  # [N/m]
_LEAST = 1e-2  # [N] below which friction is no power of the tension any more


class Physics(NamedTuple):
    """One tendon in its sheath, what holds its tip, and its start; (n,) is one value a sample."""

    friction: Array  # K, the friction coordinate of the tip, (n,)
    compliance: float  # L/EA [m/N]
    weights: Array  # share of the compliance at each node, (NODES,)
    tip_compliance: float = 0.0  # [m/N] of what the tip pulls at; 0 is a blocked tip
    drag: float = 0.0  # tau [N]: friction as if the tension were higher by so much
    viscosity: float = 0.0  # [N s/m]: the same in proportion to the local speed
    stribeck: float = 0.0  # friction times 1 + stribeck exp(-(v/stribeck_speed)^2)
    stribeck_speed: float = 1e-3  # [m/s]
    stribeck_memory: float = 0.0  # [s] that friction is late; 0: it follows the motor's speed
    static: float = 0.0  # friction of contacts at rest over that of sliding ones, less 1
    static_time: float = 0.1  # [s] of rest in which they get it
    static_distance: float = 1e-5  # [m] of sliding in which they lose it
    asymmetry: float = 1.0  # rho: friction towards the tip over friction towards the housing
    exponent: float = 1.0  # friction force ~ T^exponent
    reference: float = 10.0  # [N] of that power
    rise: float = 0.0  # [1/N] friction times 1 + rise T
    presliding: float = 0.0  # [m] that a contact gives before it slides
    presliding_tension: float = 0.0  # [N] at which it gives that much; 0: at any
    toe: float = 0.0  # [m] that the tendon stretches more at once, while strands bed in
    toe_tension: float = 2.0  # [N] over which it does
    creep: float = 0.0  # share of the elongation that comes late
    creep_time: float = 10.0  # [s]
    compression: float = 0.0  # [m/N^2] elongation above the threshold, by its square
    threshold: float = 0.0  # [N]
    stretch: Array = np.zeros(1)  # [m] by which the tendon is longer than it was, (n,) or (1,)
    tip_offset: Array = np.zeros(1)  # [m] by which the environment has taken the tip, (n,) or (1,)
    load_low: float = 0.0  # [N] at the tip, besides the spring, while it moves towards the tip
    load_high: float = 0.0  # [N] while it moves towards the housing
    load_stiffness: float = math.inf  # [N/m] with which one becomes the other
    mass: float = 0.0  # [kg] at the tip
    damping: float = 0.0  # [N s/m] at the tip
    start: float = 0.0  # [N] all along the tendon before the first sample


class Motion(NamedTuple):
    """What the ends did, shape (n,) each."""

    proximal_tension: Array  # T_in [N]
    distal_tension: Array  # T_out [N]
    proximal_displacement: Array  # q_p [m], zero for the slack tendon
    distal_displacement: Array  # q_d [m], zero for the unloaded tip
    compliance: Array  # dq_p/dT_in [m/N] as the motor went on


class _Law(NamedTuple):
    """Scalars of `Physics`, as a step uses them."""

    drag: float
    viscosity: float
    stribeck: float
    stribeck_speed: float
    stribeck_memory: float
    static: float
    static_time: float
    static_distance: float
    asymmetry: float
    exponent: float
    reference: float
    rise: float
    give: float
    give_tension: float
    toe: float  # [N] of a node's stretch, over its compliance
    toe_tension: float
    creep: float
    creep_time: float
    compression: float
    threshold: float


class _Holder(NamedTuple):
    """What the tip pulls at."""

    compliance: float  # [m/N]
    mass: float
    damping: float
    low: float
    high: float
    stiffness: float


class _Tip(NamedTuple):
    """What the tip pulls at in one sample: q_d for a tension, piecewise straight."""

    compliance: float  # [m/N] while it moves freely, inertia of this step included
    known: float  # [N] that inertia adds from the past
    offset: float  # [m]
    low: float
    high: float
    stiffness: float
    before: float  # q_d [m] one sample ago
    load: float  # [N] besides the spring, one sample ago


class _Tendon(NamedTuple):
    """A tendon at one sample: what its contacts and its elasticity do."""

    law: _Law
    half: Array  # half the friction coordinate of each contact
    drag: Array  # [N] of each contact
    dt: float  # [s]
    weights: Array  # [m/N] of each node
    scale: float  # of the elongation, by what creeps within the sample
    kept: Array  # [m] that each node's share is longer, whatever its tension


_SCALARS = 27  # before the arrays in what `constants_of` returns
VISCOSITY, STRIBECK = 1, 2  # among them
CONSTANTS = _SCALARS + 3 * NODES - 1

# Where the parts of a state begin: of each node, of the ends, of each contact
LENGTHS, _CREPT, _ENDS = NODES, 2 * NODES, 3 * NODES
_Q, _V, _A, _LOAD, _DRIVEN = range(_ENDS, _ENDS + 5)
_SLIDING = _ENDS + 5
_SPEED, _RESTED = _SLIDING + NODES - 1, _SLIDING + 2 * (NODES - 1)
STATE = _SLIDING + 3 * (NODES - 1)
"""Length of the flat array that is all a tendon remembers."""

_UNTOLD = np.empty(0)

# What `advance` is told of a sample
DT, FRICTION, STRETCH, OFFSET, COMPLIANCE, TARGET, SPEED = range(7)
SAMPLE = 7


class _Line(NamedTuple):
    """A tendon ready for steps."""

    law: _Law
    holder: _Holder
    softness: float  # [m/N]: what the tension's rate is to the motor's speed
    weights: Array  # [m/N] of each node
    even: Array  # shares of the whole
    spread: Array  # speed over each contact for that of the motor, while all slides


def even_weights() -> Array:
    """Return the weights of a sheath bent evenly."""
    return np.diff(EDGES)


def by_travel(physics: Physics, time: Array, travel: Array, speed: Array) -> Motion:
    """Return what happens when the motor goes through a `travel`.

    Parameters
    ----------
    physics : Physics
        What is driven.
    time : ndarray
        [s], shape (n,), rising.
    travel : ndarray
        q_p [m], shape (n,), zero where the tendon begins to be taut.
    speed : ndarray
        Of the motor [m/s], shape (n,); its sign does not matter.
    """
    return _driven(physics, time, travel, np.abs(speed), forced=False)


def by_tension(physics: Physics, time: Array, tension: Array, rate: Array) -> Motion:
    """Return what happens under a `tension` [N] at the housing that changes by `rate` [N/s]."""
    return _driven(physics, time, tension, np.abs(rate), forced=True)


def constants_of(physics: Physics) -> Array:
    """Return what `advance` needs to know of a tendon, as one flat array."""
    p = physics
    law = _Law(
        p.drag,
        p.viscosity,
        p.stribeck,
        p.stribeck_speed,
        p.stribeck_memory,
        p.static,
        p.static_time,
        p.static_distance,
        p.asymmetry,
        p.exponent,
        p.reference,
        p.rise,
        p.presliding,
        p.presliding_tension,
        p.toe / p.compliance,
        p.toe_tension,
        p.creep,
        p.creep_time,
        p.compression,
        p.threshold,
    )
    stiffness = min(p.load_stiffness, _STIFF)
    holder = _Holder(p.tip_compliance, p.mass, p.damping, p.load_low, p.load_high, stiffness)
    scalars = np.array([*law, *holder])
    return _packed(scalars, p.tip_compliance, p.weights * p.compliance, float(p.friction[0]))


def _driven(physics: Physics, time: Array, drive: Array, rate: Array, *, forced: bool) -> Motion:
    constants, samples = constants_of(physics), np.empty((len(time), SAMPLE))
    samples[:, DT] = np.diff(time, prepend=time[0])
    samples[:, FRICTION], samples[:, STRETCH] = physics.friction, physics.stretch
    samples[:, OFFSET], samples[:, COMPLIANCE] = physics.tip_offset, physics.tip_compliance
    samples[:, TARGET], samples[:, SPEED] = drive, rate
    memory = start(constants, physics.start, samples[0, STRETCH], samples[0, OFFSET])
    return Motion(
        *np.ascontiguousarray(advance(constants, memory, samples, _UNTOLD, forced, _SMALLEST).T)
    )


@compiled
def _tip_travel(tip: _Tip, tension: float) -> tuple[float, float, float]:
    """Return q_d [m], dq_d/dT_out [m/N] and the load besides the spring [N] at a tip tension."""
    c = tip.compliance
    if c <= 0.0:
        return tip.offset, 0.0, 0.0
    if tip.low == tip.high:
        return c * (tension + tip.known - tip.low) + tip.offset, c, tip.low
    # held by its friction: (q - offset)/c = T + known - load - stiffness (q - before)
    slope = c / (1.0 + c * tip.stiffness)
    q = tip.before + slope * (tension + tip.known - tip.load - (tip.before - tip.offset) / c)
    load = tip.load + tip.stiffness * (q - tip.before)
    if load > tip.high:
        return c * (tension + tip.known - tip.high) + tip.offset, c, tip.high
    if load < tip.low:
        return c * (tension + tip.known - tip.low) + tip.offset, c, tip.low
    return q, slope, load


@compiled
def _contacts(
    law: _Law, K: float, state: Array, speed: Array, rested: Array, half: Array, drag: Array
) -> None:
    """Fill in, for each contact, half its friction coordinate and its drag [N].

    From the tensions of the sample before, which are near enough and spare the search much.
    """
    for j in range(len(half)):
        tension = 0.5 * (state[j] + state[j + 1])
        share = max(1.0 + law.rise * tension, _SMOOTH)
        if law.exponent != 1.0:
            share *= (max(tension, _LEAST) / law.reference) ** (law.exponent - 1.0)
        if law.stribeck != 0.0:
            x = speed[j] / law.stribeck_speed
            share *= 1.0 + law.stribeck * math.exp(-x * x)
        if law.static != 0.0:
            share *= 1.0 + law.static * rested[j]
        ds = K * (PLACES[j + 1] - PLACES[j])
        half[j] = min(0.5 * ds * share, _STEEPEST / max(1.0, law.asymmetry))
        drag[j] = 2.0 * half[j] * law.drag


@compiled
def _rest(law: _Law, dt: float, slid: Array, rested: Array) -> None:
    """Let contacts take hold while they rest and let go while they slide, in place."""
    kept = math.exp(-dt / law.static_time)
    for j in range(len(rested)):
        rested[j] = 1.0 - (1.0 - rested[j]) * kept
        rested[j] *= math.exp(-abs(slid[j]) / law.static_distance)


@compiled
def _stretch(tendon: _Tendon, j: int, tension: float) -> tuple[float, float]:
    """Return the elongation [m] of a node's share of the tendon, and its slope [m/N]."""
    law, weight = tendon.law, tendon.weights[j]
    e, slope = weight * tension, weight
    if law.toe != 0.0:
        fading = math.exp(-max(tension, 0.0) / law.toe_tension)
        e += weight * law.toe * (1.0 - fading)
        slope += weight * law.toe / law.toe_tension * fading
    if j == 0 and law.compression != 0.0 and tension > law.threshold:
        e += law.compression * (tension - law.threshold) ** 2
        slope += 2.0 * law.compression * (tension - law.threshold)
    return tendon.scale * e, tendon.scale * slope


@compiled
def _slide(
    tendon: _Tendon,
    tip: _Tip,
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
                stretch, slope[j] = _stretch(tendon, j, after[j])
                stiff[j] = 1.0 / slope[j]
                zero[j] = after[j] - (stretch + kept[j] - lengths[j]) * stiff[j]
            free_slope, free_zero = slope[last], zero[last]
        q, dq, _load = _tip_travel(tip, after[last])
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


@compiled
def _lean(
    tendon: _Tendon, tip: _Tip, before: Array, lengths: Array, T_out: float, after: Array
) -> tuple[float, float, float]:
    """Go from the tip to the housing over contacts that give before they slide.

    Returns the travel of the motor [m], its slope by T_out, and that of T_in.
    """
    law = tendon.law
    last = len(before) - 1
    q_d, by, _load = _tip_travel(tip, T_out)
    moved = q_d - tip.before
    after[last] = T_out
    T, D = T_out, 1.0
    q_p, dq_p = q_d, by
    for j in range(last - 1, -1, -1):
        part, part_by = _stretch(tendon, j + 1, T)
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
    part, part_by = _stretch(tendon, 0, T)
    return q_p + part + tendon.kept[0], dq_p + part_by * D, D


@compiled
def _settle(
    tendon: _Tendon,
    tip: _Tip,
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
    for _ in range(_ROUNDS):
        q_p, dq_p, D = _lean(tendon, tip, before, lengths, T, after)
        over, by = (after[0] - target, D) if forced else (q_p - target, dq_p)
        if abs(over) < _ENOUGH or (T == 0.0 and over > 0.0):
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


@compiled
def _spread(weights: Array, K: float, compliance: float) -> Array:
    """Return the speed over each contact for that of the motor, while all of the tendon slides."""
    n = len(weights)
    tension = np.exp(-K * PLACES)
    spread = np.empty(n - 1)
    total = compliance * tension[n - 1]
    for j in range(n - 2, -1, -1):
        total += weights[j + 1] * tension[j + 1]
        spread[j] = total
    spread /= total + weights[0]
    return spread


@compiled
def _packed(scalars: Array, compliance: float, weights: Array, friction: float) -> Array:
    """Return a `_Line` as one flat array; `scalars` are those of its law and its holder."""
    total = weights.sum()
    row = np.empty(CONSTANTS)
    row[: _SCALARS - 1], row[_SCALARS - 1] = scalars, total + compliance
    rest = row[_SCALARS:]
    rest[:NODES], rest[NODES : 2 * NODES] = weights, weights / total
    rest[2 * NODES :] = _spread(weights, friction, compliance)
    return row


@compiled
def _line(constants: Array) -> _Line:
    """Return what `constants_of` has packed."""
    c, last = constants, NODES - 1
    law = _Law(
        c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9],
        c[10], c[11], c[12], c[13], c[14], c[15], c[16], c[17], c[18], c[19],
    )  # fmt: skip
    holder = _Holder(c[20], c[21], c[22], c[23], c[24], c[25])
    weights, rest = constants[_SCALARS : _SCALARS + NODES], constants[_SCALARS + NODES :]
    return _Line(law, holder, c[26], weights, rest[:NODES], rest[NODES : NODES + last])


@compiled
def start(constants: Array, tension: float, stretch: float, offset: float) -> Array:
    """Return the state of a tendon that has not moved yet, at one `tension` [N] all along.

    It is `stretch` [m] longer than it was, and the environment has taken its tip to `offset` [m].
    """
    line = _line(constants)
    state = np.zeros(STATE)
    state[:NODES] = tension
    kept = line.even * stretch
    none = np.empty(0)
    tendon = _Tendon(line.law, none, none, 0.0, line.weights, 1.0, kept)
    for j in range(NODES):
        state[LENGTHS + j] = _stretch(tendon, j, tension)[0] + kept[j]
    state[_Q] = line.holder.compliance * tension + offset
    state[_DRIVEN] = math.nan
    state[_RESTED:] = 1.0
    return state


@compiled
def advance(
    constants: Array, memory: Array, samples: Array, speeds: Array, forced: bool, smallest: float
) -> Array:
    """Take samples one after another, in place; return the rows of `Motion`, shape (n, 5).

    Parameters
    ----------
    constants, memory : ndarray
        From `constants_of` and `start`, or a step before.
    samples : ndarray
        (n, SAMPLE): time since the sample before [s], K, `Physics.stretch` and `tip_offset` [m],
        `tip_compliance` [m/N], what the motor is driven to, and its speed.
    speeds : ndarray
        Over each contact [m/s], where Stribeck's friction shall not go by what the steps find;
        else empty.
    forced : bool
        Whether it is driven to a tension [N] and [N/s], or to a travel [m] and [m/s].
    smallest : float
        Share of a sample in which what has no balance yet is tried again; 1 for once only.
    """
    law, holder, softness, weights, even, spread = _line(constants)
    out = np.empty((len(samples), 5))
    mass, damping, told = holder.mass, holder.damping, len(speeds) > 0
    late = law.stribeck != 0.0 and law.stribeck_memory > 0.0
    leans = law.give > 0.0
    state, lengths = memory[:NODES], memory[LENGTHS:_CREPT]
    crept, sliding = memory[_CREPT:_ENDS], memory[_SLIDING:_SPEED]
    speed, rested = memory[_SPEED:_RESTED], memory[_RESTED:]
    after, work = np.empty(NODES), np.empty((6, NODES))
    half, drag = np.empty(NODES - 1), np.empty(NODES - 1)
    slid, gone = np.zeros(NODES - 1), np.zeros(NODES - 1)
    q, v, a, load, before = memory[_Q], memory[_V], memory[_A], memory[_LOAD], memory[_DRIVEN]
    for i in range(len(samples)):
        dt, friction, stretch = samples[i, DT], samples[i, FRICTION], samples[i, STRETCH]
        offset, compliance = samples[i, OFFSET], samples[i, COMPLIANCE]
        target, rate = samples[i, TARGET], samples[i, SPEED]
        heavy = compliance > 0.0 and (mass > 0.0 or damping > 0.0)
        gain = -math.expm1(-dt / law.creep_time) if law.creep != 0.0 else 0.0
        kept = crept * (1.0 - gain) + even * stretch
        scale = 1.0 + law.creep * gain
        tendon = _Tendon(law, half, drag, dt, weights, scale, kept)
        c, known = compliance, 0.0
        if heavy and dt > 0.0:  # the trapezoidal rule: what follows from the past, and what is free
            from_rest = q - offset
            c = compliance / (1.0 + compliance * (4.0 * mass / dt + 2.0 * damping) / dt)
            known = mass * (4.0 * (from_rest / dt + v) / dt + a)
            known += damping * (2.0 * from_rest / dt + v)
        tip = _Tip(c, known, offset, holder.low, holder.high, holder.stiffness, q, load)
        if law.stribeck != 0.0 and not late:
            speed[:] = speeds if told else spread * (rate * softness if forced else rate)
        _contacts(law, friction, state, speed, rested, half, drag)
        if leans:
            reach = _settle(tendon, tip, state, lengths, target, forced, after)
            state[:] = after
            for j in range(NODES):
                lengths[j] = _stretch(tendon, j, after[j])[0] + kept[j]
        else:
            begin = target if math.isnan(before) else before
            most = _PIECE if law.static != 0.0 else 1.0
            done, share, reach = 0.0, most, 0.0
            gone[:] = 0.0
            while done < 1.0:
                goal = begin + (done + share) * (target - begin)
                part = _Tendon(law, half, drag, share * dt, weights, scale, kept)
                ended, reach = _slide(
                    part, tip, state, lengths, goal, forced, after, sliding, slid, work
                )
                if not ended:  # in circles: from rest, and if need be by a smaller step
                    sliding[:] = 0.0
                    ended, reach = _slide(
                        part, tip, state, lengths, goal, forced, after, sliding, slid, work
                    )
                if not ended and share > smallest and not heavy:
                    sliding[:] = 0.0
                    share *= 0.5
                    continue
                done += share
                share = min(2.0 * share, most, 1.0 - done)
                gone += slid
                state[:] = after
                if law.static != 0.0:
                    _rest(law, part.dt, slid, rested)
                    _contacts(law, friction, state, speed, rested, half, drag)
                for j in range(NODES):
                    lengths[j] = _stretch(part, j, after[j])[0] + kept[j]
                at, _slope, load = _tip_travel(tip, after[NODES - 1])
                if done < 1.0:
                    tip = _Tip(c, known, offset, tip.low, tip.high, tip.stiffness, at, load)
        if late and dt > 0.0:
            now = speeds if told else np.abs(gone) / dt
            speed += -math.expm1(-dt / law.stribeck_memory) * (now - speed)
        new, _slope, load = _tip_travel(tip, after[NODES - 1])
        if dt > 0.0:
            v_new = 2.0 * (new - q) / dt - v
            a = 2.0 * (v_new - v) / dt - a
            v = v_new
        q, before = new, target
        if gain > 0.0:
            crept *= 1.0 - gain
            crept += law.creep * gain / scale * (lengths - kept)
        out[i, 0], out[i, 1] = after[0], after[NODES - 1]
        out[i, 2], out[i, 3], out[i, 4] = lengths.sum() + q, q, reach
    memory[_Q], memory[_V], memory[_A], memory[_LOAD], memory[_DRIVEN] = q, v, a, load, before
    return out
