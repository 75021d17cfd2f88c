"""Friction limits of a node in its bend, linearised over a step.

Dry friction f on a node between the tensions T_p on its housing side and T_d on its tip side obeys
Coulomb's law with the normal force of the tendon on the bend,

    f = T_p - T_d,   -phi_t (T_m + tau) <= f <= phi_h (T_m + tau),   T_m = (T_p + T_d) / 2

and is at its upper limit where the node slides towards the housing, at its lower one where it
slides towards the tip. With the factors of one step given, the limits are linear in the tensions:

    T_d + tau = pull (T_p + tau)      sliding towards the housing, pull = (2 - phi_h)/(2 + phi_h)
    T_d + tau = release (T_p + tau)   sliding towards the tip, release = (2 + phi_t)/(2 - phi_t)

phi_h = phi s and phi_t = rho phi s depend on the node's state after the last step:

    s = scale * (T_m / T_r)^(n - 1) * (1 + k max(0, T_m - T_b))      tension
        * (1 + a exp(-(v / v_s)^2))                                  speed v, low-pass filtered
        * (1 + (static_ratio - 1) R)                                 growth R of the contact at rest

R approaches 1 in `static_time` of rest and 0 in `static_distance` of sliding. Every factor is
positive and friction opposes motion, so friction is dissipative. The delay of one step is a
first-order error.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile, jit_inline
from slave.rigs.simulated.plant.knobs import Knobs
from slave.rigs.simulated.plant.tendon import CONTACT_GROWTH, SPEED, TENSION, Chain

NODE_FRICTION_MAX = 1.5  # of a node's friction: at 2 the discretisation would jam
# of all nodes together: nothing is transmitted, and more is lost in rounding
TOTAL_FRICTION_MAX = 15.0
RIGID_STIFFNESS = 1e10  # [N/m] of a practically rigid bristle
LIGHT_TENSION = 0.5  # [N] below it friction is proportional to tension for any exponent


class Contacts(NamedTuple):
    """The friction of all nodes during one step."""

    pull: Array  # shape (n,), below 1
    release: Array  # shape (n,), above 1
    drag: float  # tau [N]
    bristle: Array  # [N/m] shape (n,); both empty for rigid-plastic friction
    dashpot: Array  # [N/m] shape (n,), force over motion in this step


@jit_inline
def compute_contacts(chain: Chain, state: Array, dt: float) -> Contacts:
    """Return the friction during a step of `dt` [s] from `state`."""
    knobs, tension = chain.knobs, state[TENSION]
    n = len(chain.friction)
    pull, release, total = np.empty(n), np.empty(n), 0.0
    for i in range(n):
        friction = chain.friction[i] * knobs.friction_scale
        if knobs.tension_exponent != 1.0 or knobs.compression_friction != 0.0:
            friction *= compute_tension_factor(knobs, 0.5 * (tension[i] + tension[i + 1]))
        if knobs.stribeck_ratio != 0.0:
            relative = state[SPEED, i + 1] / knobs.stribeck_speed
            friction *= 1.0 + knobs.stribeck_ratio * math.exp(-relative * relative)
        friction *= 1.0 + (knobs.static_ratio - 1.0) * state[CONTACT_GROWTH, i + 1]
        housing = min(friction, NODE_FRICTION_MAX, TOTAL_FRICTION_MAX - total)
        tip = min(housing * knobs.asymmetry, NODE_FRICTION_MAX)
        total += housing
        pull[i] = (2.0 - housing) / (2.0 + housing)
        release[i] = (2.0 + tip) / (2.0 - tip)
    leaning = n if knobs.presliding > 0.0 or knobs.viscosity > 0.0 else 0
    bristle, dashpot = np.full(leaning, RIGID_STIFFNESS), np.empty(leaning)
    for i in range(leaning):
        dashpot[i] = knobs.viscosity * chain.cell[i] / dt
        if knobs.presliding > 0.0 and chain.friction[i] > 0.0:
            bristle[i] = chain.friction[i] * knobs.presliding_tension / knobs.presliding
    return Contacts(pull, release, knobs.drag, bristle, dashpot)


@jit_compile
def compute_tension_factor(knobs: Knobs, tension: float) -> float:
    """Return the tension-dependent factor of friction at `tension` [N] on the bend."""
    factor = (max(tension, LIGHT_TENSION) / knobs.tension_reference) ** (
        knobs.tension_exponent - 1.0
    )
    above = max(0.0, tension - knobs.compression_threshold)
    return float(factor * (1.0 + knobs.compression_friction * above))


@jit_compile
def filter_speed(knobs: Knobs, before: float, speed: float, dt: float) -> float:
    """Return the filtered speed [m/s] after `dt` [s] at `speed`."""
    if knobs.stribeck_ratio == 0.0:
        return speed
    return speed + (before - speed) * math.exp(-dt / knobs.stribeck_memory)


@jit_compile
def advance_contact_growth(knobs: Knobs, before: float, speed: float, dt: float) -> float:
    """Return the growth R of a contact after `dt` [s] at `speed` [m/s].

    dR/dt = (1 - R) / static_time - R |v| / static_distance
    """
    if knobs.static_ratio == 1.0:
        return 1.0 if speed == 0.0 else 0.0
    grow = 1.0 / knobs.static_time
    rate = grow + abs(speed) / knobs.static_distance
    final = grow / rate
    return final + (before - final) * math.exp(-rate * dt)
