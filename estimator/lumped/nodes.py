"""One tendon on nodes of bend angle: what each node, each contact and the tip do in a sample.

Nodes carry the elasticity, contacts between them the friction. How all of them balance is another
matter: `estimator.lumped.stick_slip_solver` and `estimator.lumped.presliding_solver`.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_borrow

NODES = 41
"""Nodes from housing to tip."""

_GRADED = 2.5
PLACES = np.expm1(_GRADED * np.linspace(0.0, 1.0, NODES)) / math.expm1(_GRADED)
"""Where nodes are, shares of K: close at the housing, where every reversal begins."""

EDGES = np.concatenate([[0.0], 0.5 * (PLACES[:-1] + PLACES[1:]), [1.0]])
"""Where the stretch of tendon that counts to a node ends and the next begins, shares of K."""

_FRICTION_MIN = 0.05  # of K, that friction never falls below, however far a fit is carried on
# half the friction between two nodes, at most; beyond it nothing would pass
_HALF_FRICTION_MAX = 0.45
_MIN_TENSION = 1e-2  # [N] below which friction is no power of the tension any more


class FrictionLaw(NamedTuple):
    """Scalars of `lumped_model.Physics`, as a step uses them."""

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
    presliding: float
    presliding_tension: float
    toe: float  # [N] of a node's stretch, over its compliance
    toe_tension: float
    creep: float
    creep_time: float
    compression: float
    threshold: float
    depth: float  # friction coordinate of the last node, over K


class Tip(NamedTuple):
    """What the tip pulls at in one sample: q_d for a tension, piecewise straight."""

    compliance: float  # [m/N] while it moves freely, inertia of this step included
    inertia_force: float  # [N] that inertia adds from the past
    offset: float  # [m]
    low: float
    high: float
    stiffness: float
    contact: float  # [m] of q_d from which on it meets something
    contact_stiffness: float  # [N/m] of that
    q_old: float  # q_d [m] one sample ago
    load: float  # [N] besides the spring, one sample ago


class Tendon(NamedTuple):
    """A tendon at one sample: what its contacts and its elasticity do."""

    law: FrictionLaw
    half_k: Array  # half the friction coordinate of each contact
    drag: Array  # [N] of each contact
    dt: float  # [s]
    weights: Array  # [m/N] of each node
    scale: float  # of the elongation, by what creeps within the sample
    extra: Array  # [m] that each node's share is longer, whatever its tension
    tip_compliance: Array  # [m/N] of the tip's load that each node but the last carries


def build_even_weights() -> Array:
    """Return the weights of a sheath bent evenly."""
    return np.diff(EDGES)


@jit_borrow
def compute_tip_travel(tip: Tip, tension: float) -> tuple[float, float, float]:
    """Return q_d [m], dq_d/dT_out [m/N] and the load besides the spring [N] at a tip tension."""
    c = tip.compliance
    if c <= 0.0:
        return tip.offset, 0.0, 0.0
    q, slope, load = _compute_spring_travel(tip, c, tip.offset, tension)
    if q > tip.contact and tip.contact_stiffness > 0.0:  # two springs side by side, as one
        stiffness = 1.0 / c + tip.contact_stiffness
        offset = (tip.offset / c + tip.contact_stiffness * tip.contact) / stiffness
        q, slope, load = _compute_spring_travel(tip, 1.0 / stiffness, offset, tension)
    return q, slope, load


@jit_borrow
def _compute_spring_travel(
    tip: Tip, c: float, offset: float, tension: float
) -> tuple[float, float, float]:
    """Return what `compute_tip_travel` does, of one spring of compliance `c` [m/N]."""
    force = tension + tip.inertia_force
    if tip.low == tip.high:
        return c * (force - tip.low) + offset, c, tip.low
    # held by its friction: (q - offset)/c = T + inertia_force - load - stiffness (q - q_old)
    slope = c / (1.0 + c * tip.stiffness)
    q = tip.q_old + slope * (force - tip.load - (tip.q_old - offset) / c)
    load = tip.load + tip.stiffness * (q - tip.q_old)
    if load > tip.high:
        return c * (force - tip.high) + offset, c, tip.high
    if load < tip.low:
        return c * (force - tip.low) + offset, c, tip.low
    return q, slope, load


@jit_borrow
def fill_contacts(
    law: FrictionLaw,
    K: float,
    T_old: Array,
    speed: Array,
    adhesion: Array,
    half_k: Array,
    drag: Array,
) -> None:
    """Fill in, for each contact, half its friction coordinate and its drag [N].

    From the tensions of the sample before, which are near enough and spare the search much.
    """
    half_k_max = _HALF_FRICTION_MAX / max(1.0, law.asymmetry)
    for j in range(len(half_k)):
        half_k[j] = 0.5 * (K * law.depth * (PLACES[j + 1] - PLACES[j]))
    if law.rise != 0.0 or law.exponent != 1.0 or law.stribeck != 0.0 or law.static != 0.0:
        for j in range(len(half_k)):
            tension = 0.5 * (T_old[j] + T_old[j + 1])
            share = max(1.0 + law.rise * tension, _FRICTION_MIN)
            if law.exponent != 1.0:
                share *= (max(tension, _MIN_TENSION) / law.reference) ** (law.exponent - 1.0)
            if law.stribeck != 0.0:
                x = speed[j] / law.stribeck_speed
                share *= 1.0 + law.stribeck * math.exp(-x * x)
            if law.static != 0.0:
                share *= 1.0 + law.static * adhesion[j]
            half_k[j] *= share
    for j in range(len(half_k)):
        half_k[j] = min(half_k[j], half_k_max)
        drag[j] = 2.0 * half_k[j] * law.drag


@jit_borrow
def age_contacts(law: FrictionLaw, dt: float, slip: Array, adhesion: Array) -> None:
    """Let contacts take hold while they rest and let go while they slide, in place."""
    decay = math.exp(-dt / law.static_time)
    for j in range(len(adhesion)):
        adhesion[j] = 1.0 - (1.0 - adhesion[j]) * decay
        adhesion[j] *= math.exp(-abs(slip[j]) / law.static_distance)


@jit_borrow
def compute_elongation(tendon: Tendon, j: int, tension: float) -> tuple[float, float]:
    """Return the elongation [m] of a node's share of the tendon, and its slope [m/N].

    With what the tip gives under its part of the force there.
    """
    law, weight = tendon.law, tendon.weights[j]
    e, slope = weight * tension, weight
    if law.toe != 0.0:
        decay = math.exp(-max(tension, 0.0) / law.toe_tension)
        e += weight * law.toe * (1.0 - decay)
        slope += weight * law.toe / law.toe_tension * decay
    if j == 0 and law.compression != 0.0 and tension > law.threshold:
        e += law.compression * (tension - law.threshold) ** 2
        slope += 2.0 * law.compression * (tension - law.threshold)
    tip_compliance = tendon.tip_compliance[j]
    return (tendon.scale * e + tip_compliance * tension, tendon.scale * slope + tip_compliance)
