"""Discretised tendon: springs, friction nodes, their laws linearised over a step, and their state.

The friction of a cell of sheath acts in its middle, on a node of the tendon; the tendon between two
nodes is a spring that can only pull. Displacements are positive towards the housing.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile, jit_inline
from slave.sheath_section import SectionConfig
from teleop.config.ranges import build_ranged_field, check_ranges

# --- run-time parameters of a tendon: one number per effect, neutral by default
# The chain reads them at every step, so a fault that starts or grows is a changing value. `effects`
# changes them by name and time.


class TendonDeviations(NamedTuple):
    """The deviations of one tendon from an elastic one with Coulomb friction."""

    # friction, of friction
    friction_scale: float = 1.0  # of the friction of every bend
    asymmetry: float = 1.0  # rho, friction towards the tip over friction towards the housing
    drag: float = 0.0  # tau [N] added to the tension that presses on a bend
    viscosity: float = 0.0  # [N s/m^2] friction per metre of sheath and per speed
    tension_exponent: float = 1.0  # n of friction ~ T^n
    tension_reference: float = 10.0  # [N] reference of the exponent
    stribeck_ratio: float = 0.0  # friction at rest over that at high speed, less one
    stribeck_speed: float = 1e-3  # [m/s]
    stribeck_memory: float = 0.2  # [s] time constant of the speed in the friction
    static_ratio: float = 1.0  # static over sliding friction after long rest
    static_time: float = 0.5  # [s] time constant of growth at rest
    static_distance: float = 2e-5  # [m] sliding distance of its decay
    presliding: float = 0.0  # [m] elastic deflection of a contact before it slides
    presliding_tension: float = 10.0  # [N] tension of that deflection, which is proportional to it

    # elasticity, of elasticity
    toe_strain: float = 0.0  # eps_0, strain of the toe
    toe_tension: float = 2.0  # [N] T_s of the toe
    compression: float = 0.0  # [m/N^2] of the whole sheath, above the threshold
    compression_threshold: float = 0.0  # [N]
    compression_friction: float = 0.0  # [1/N] relative rise of friction above the threshold
    creep_share: float = 0.0  # a, final creep over elastic elongation
    creep_time: float = 10.0  # [s]
    slack: float = 0.0  # [m] of excess tendon
    expansion: float = 0.0  # thermal strain of the tendon less that of the sheath


NEUTRAL = TendonDeviations()

# --- sheath config and its discretisation into cells

TOTAL_MAX = 10.0  # K of a whole sheath; transmits 1/20000 of the tension
FRICTION_MAX = 1.0  # of one cell: above it cells are too coarse, and at 2 a chain would jam


@dataclass(frozen=True, slots=True)
class SheathConfig:
    """A tendon in its sheath; the one of Phee et al. 2009 as far as it is known, K about 1."""

    sections: tuple[SectionConfig, ...] = (SectionConfig(1.5, 0.225),)  # housing to tip
    friction: float = build_ranged_field(0.15, 0.0, 2.0)  # mu, dimensionless, of tendon on sheath
    # EA [N] of tendon and sheath in series
    axial_stiffness: float = build_ranged_field(9000.0, 1.0, 1e7, "N")
    nodes: int = build_ranged_field(60, 1, 1000)  # number of cells

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.sections:
            raise ValueError("sections: at least one is needed")
        bend = divide_sheath(self)[1]
        if self.friction * bend.sum() > TOTAL_MAX:
            raise ValueError(
                f"friction: must be at most {TOTAL_MAX / bend.sum():.3g} with these bends, or no "
                "tension is transmitted"
            )
        friction = self.friction * bend.max()
        if friction >= FRICTION_MAX:
            nodes_min = math.ceil(self.nodes * friction / FRICTION_MAX) + 1
            raise ValueError(f"nodes: must be at least about {nodes_min} to resolve this friction")


def divide_sheath(config: SheathConfig) -> tuple[Array, Array]:
    """Divide a sheath into cells of similar length, at least one per section.

    Returns length [m] and bend angle [rad] of each cell, housing to tip, shape (n,).
    """
    length = np.array([section.length for section in config.sections])
    radius = np.array([section.radius for section in config.sections])
    count = np.maximum(1, np.round(config.nodes * length / length.sum())).astype(np.int64)
    cell = np.repeat(length / count, count)
    return cell, cell / np.repeat(radius, count)


# Rows of a state. Entry i of a row of nodes belongs to node i = 1 ... n, beside POSITION.
POSITION = 0  # [m] of the motor's end, the nodes and the tip
TENSION = 1  # [N] of spring i = 0 ... n, between positions i and i + 1
FRICTION = 2  # [N] dry friction on each node, positive towards the tip
CREEP = 3  # [N] of each spring: its creep as an equivalent tension
SPEED = 4  # [m/s] of each node, filtered for its friction
CONTACT_GROWTH = 5  # growth of each contact at rest: 0 just slid, 1 rested long
STATE_ROWS = 6


class Chain(NamedTuple):
    """One tendon in one sheath: n nodes and n + 1 springs, from the housing to the tip."""

    compliance: Array  # c_i [m/N] shape (n + 1,)
    friction: Array  # phi_i [-] shape (n,): friction coefficient times bend angle of a cell
    cell: Array  # [m] shape (n,): its length
    pretension: float  # [N] in every spring while all displacements are zero
    deviations: TendonDeviations
    parted: Array  # [m] shape (n + 1,): gap in a broken spring; 0 = not broken


def build_chain(config: SheathConfig, pretension: float) -> Chain:
    """Return the chain of a sheath, its deviations neutral.

    `pretension` [N] is the tension all along the tendon while all displacements are zero.
    """
    cell, bend = divide_sheath(config)
    half = 0.5 * cell / config.axial_stiffness
    compliance = np.concatenate([half, [0.0]]) + np.concatenate([[0.0], half])
    parted = np.zeros(len(compliance))
    return Chain(compliance, config.friction * bend, cell, pretension, NEUTRAL, parted)


@jit_compile
def init_chain_state(chain: Chain) -> Array:
    """Return the initial state of a tendon, shape (6, n + 2).

    Row 0 holds the displacements [m] of motor end, nodes and tip; the others are this plant's own.
    """
    n = len(chain.friction)
    state = np.zeros((STATE_ROWS, n + 2))
    state[TENSION, : n + 1] = chain.pretension
    state[CONTACT_GROWTH, 1 : n + 1] = 1.0
    return state


@jit_compile
def get_tensions(chain: Chain, state: Array) -> Array:
    """Return the tension of each spring [N], housing to tip, shape (n + 1,)."""
    return state[TENSION, : len(chain.compliance)].copy()


# --- the elasticity of a tendon in its sheath, linearised over a step
# A spring of compliance c between two nodes stretches, from where it is at its pretension, by
#
#     s = c (E(T) - E(T_0) + y + w) + gap,   E(T) = T + A (1 - exp(-T / T_s)) + B max(0, T - T_b)^2
#
# A = eps_0 EA is the toe of the strands; B = beta / C the compression of the sheath, with the
# compliance C of the whole. y is creep as an equivalent tension: tau_c dy/dt = a (T - T_0) - y, a
# standard linear solid. w = slack / C + EA strain is excess tendon, distributed along it; a gap is
# a break.
#
# A step of dt has y_new = y + g (a (T_new - T_0) - y) with g = 1 - exp(-dt / tau_c), exact for a
# constant tension, and E as its tangent at the last tension, so that s = compliance T + rest. The
# tangent is of E itself and not of its change, so errors do not accumulate.


class Springs(NamedTuple):
    """The springs during one step: stretch [m] = compliance * tension + rest, where taut."""

    compliance: Array  # [m/N] shape (n + 1,)
    rest: Array  # [m] shape (n + 1,)


@jit_inline
def compute_springs(chain: Chain, state: Array, dt: float) -> Springs:
    """Return the springs during a step of `dt` [s] from `state`."""
    deviations, pretension = chain.deviations, chain.pretension
    total = chain.compliance.sum()
    stiffness = chain.cell.sum() / total
    toe, compression = deviations.toe_strain * stiffness, deviations.compression / total
    too_much = deviations.slack / total + deviations.expansion * stiffness
    at_start = compute_bedding(deviations, toe, compression, pretension)[0]
    gain = compute_creep_gain(deviations, dt)
    soft = 1.0 + gain * deviations.creep_share
    compliance, rest = np.empty_like(chain.compliance), np.empty_like(chain.compliance)
    for i in range(len(compliance)):
        tension = state[TENSION, i]
        bedding, slope = compute_bedding(deviations, toe, compression, tension)
        offset = bedding - slope * tension - at_start - pretension * soft
        offset += state[CREEP, i] * (1.0 - gain) + too_much
        compliance[i] = chain.compliance[i] * (soft + slope)
        rest[i] = chain.compliance[i] * offset + chain.parted[i]
    return Springs(compliance, rest)


@jit_compile
def compute_bedding(
    deviations: TendonDeviations, toe: float, compression: float, tension: float
) -> tuple[float, float]:
    """Return E(T) - T [N] and its slope at `tension` [N]."""
    elongation, slope = 0.0, 0.0
    if toe != 0.0:
        decay = math.exp(-tension / deviations.toe_tension)
        elongation += toe * (1.0 - decay)
        slope += toe / deviations.toe_tension * decay
    excess = tension - deviations.compression_threshold
    if compression != 0.0 and excess > 0.0:
        elongation += compression * excess * excess
        slope += 2.0 * compression * excess
    return elongation, slope


@jit_compile
def compute_creep_gain(deviations: TendonDeviations, dt: float) -> float:
    """Return the fraction of the remaining creep completed in a step of `dt` [s]."""
    return -math.expm1(-dt / deviations.creep_time)


@jit_compile
def advance_creep(chain: Chain, creep: float, tension: float, gain: float) -> float:
    """Return the creep [N] of a spring after a step at `tension` [N], with the step's `gain`."""
    final = chain.deviations.creep_share * (tension - chain.pretension)
    return creep + gain * (final - creep)


# --- friction limits of a node in its bend, linearised over a step
# Dry friction f on a node between the tensions T_p on its housing side and T_d on its tip side
# obeys Coulomb's law with the normal force of the tendon on the bend,
#
#     f = T_p - T_d,   -phi_t (T_m + tau) <= f <= phi_h (T_m + tau),   T_m = (T_p + T_d) / 2
#
# and is at its upper limit where the node slides towards the housing, at its lower one where it
# slides towards the tip. With the factors of one step given, the limits are linear in the tensions:
#
#     T_d + tau = pull (T_p + tau)      sliding towards the housing, pull = (2 - phi_h)/(2 + phi_h)
#     T_d + tau = release (T_p + tau)   sliding towards the tip, release = (2 + phi_t)/(2 - phi_t)
#
# phi_h = phi s and phi_t = rho phi s depend on the node's state after the last step:
#
#     s = scale * (T_m / T_r)^(n - 1) * (1 + k max(0, T_m - T_b))      tension
#         * (1 + a exp(-(v / v_s)^2))                                  speed v, low-pass filtered
#       * (1 + (static_ratio - 1) R)                                 growth R of the contact at rest
#
# R approaches 1 in `static_time` of rest and 0 in `static_distance` of sliding. Every factor is
# positive and friction opposes motion, so friction is dissipative. The delay of one step is a
# first-order error.


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
    deviations, tension = chain.deviations, state[TENSION]
    n = len(chain.friction)
    pull, release, total = np.empty(n), np.empty(n), 0.0
    for i in range(n):
        friction = chain.friction[i] * deviations.friction_scale
        if deviations.tension_exponent != 1.0 or deviations.compression_friction != 0.0:
            friction *= compute_tension_factor(deviations, 0.5 * (tension[i] + tension[i + 1]))
        if deviations.stribeck_ratio != 0.0:
            relative = state[SPEED, i + 1] / deviations.stribeck_speed
            friction *= 1.0 + deviations.stribeck_ratio * math.exp(-relative * relative)
        friction *= 1.0 + (deviations.static_ratio - 1.0) * state[CONTACT_GROWTH, i + 1]
        housing = min(friction, NODE_FRICTION_MAX, TOTAL_FRICTION_MAX - total)
        tip = min(housing * deviations.asymmetry, NODE_FRICTION_MAX)
        total += housing
        pull[i] = (2.0 - housing) / (2.0 + housing)
        release[i] = (2.0 + tip) / (2.0 - tip)
    leaning = n if deviations.presliding > 0.0 or deviations.viscosity > 0.0 else 0
    bristle, dashpot = np.full(leaning, RIGID_STIFFNESS), np.empty(leaning)
    for i in range(leaning):
        dashpot[i] = deviations.viscosity * chain.cell[i] / dt
        if deviations.presliding > 0.0 and chain.friction[i] > 0.0:
            bristle[i] = chain.friction[i] * deviations.presliding_tension / deviations.presliding
    return Contacts(pull, release, deviations.drag, bristle, dashpot)


@jit_compile
def compute_tension_factor(deviations: TendonDeviations, tension: float) -> float:
    """Return the tension-dependent factor of friction at `tension` [N] on the bend."""
    factor = (max(tension, LIGHT_TENSION) / deviations.tension_reference) ** (
        deviations.tension_exponent - 1.0
    )
    excess = max(0.0, tension - deviations.compression_threshold)
    return float(factor * (1.0 + deviations.compression_friction * excess))


@jit_compile
def filter_speed(deviations: TendonDeviations, filtered: float, speed: float, dt: float) -> float:
    """Return the filtered speed [m/s] after `dt` [s] at `speed`."""
    if deviations.stribeck_ratio == 0.0:
        return speed
    return speed + (filtered - speed) * math.exp(-dt / deviations.stribeck_memory)


@jit_compile
def advance_contact_growth(
    deviations: TendonDeviations, growth: float, speed: float, dt: float
) -> float:
    """Return the growth R of a contact after `dt` [s] at `speed` [m/s].

    dR/dt = (1 - R) / static_time - R |v| / static_distance
    """
    if deviations.static_ratio == 1.0:
        return 1.0 if speed == 0.0 else 0.0
    grow = 1.0 / deviations.static_time
    rate = grow + abs(speed) / deviations.static_distance
    final = grow / rate
    return final + (growth - final) * math.exp(-rate * dt)
