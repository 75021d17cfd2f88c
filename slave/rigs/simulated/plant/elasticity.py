"""The elasticity of a tendon in its sheath, linearised over a step.

A spring of compliance c between two nodes stretches, from where it is at its pretension, by

    s = c (E(T) - E(T_0) + y + w) + gap,   E(T) = T + A (1 - exp(-T / T_s)) + B max(0, T - T_b)^2

A = eps_0 EA is the toe of the strands; B = beta / C the compression of the sheath, with the
compliance C of the whole. y is creep as an equivalent tension: tau_c dy/dt = a (T - T_0) - y, a
standard linear solid. w = slack / C + EA strain is excess tendon, distributed along it; a gap is a
break.

A step of dt has y_new = y + g (a (T_new - T_0) - y) with g = 1 - exp(-dt / tau_c), exact for a
constant tension, and E as its tangent at the last tension, so that s = compliance T + rest. The
tangent is of E itself and not of its change, so errors do not accumulate.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile, jit_inline
from slave.rigs.simulated.plant.knobs import Knobs
from slave.rigs.simulated.plant.tendon import CREEP, TENSION, Chain


class Springs(NamedTuple):
    """The springs during one step: stretch [m] = compliance * tension + rest, where taut."""

    compliance: Array  # [m/N] shape (n + 1,)
    rest: Array  # [m] shape (n + 1,)


@jit_inline
def compute_springs(chain: Chain, state: Array, dt: float) -> Springs:
    """Return the springs during a step of `dt` [s] from `state`."""
    knobs, pretension = chain.knobs, chain.pretension
    whole = chain.compliance.sum()
    stiffness = chain.cell.sum() / whole
    toe, compression = knobs.toe_strain * stiffness, knobs.compression / whole
    too_much = knobs.slack / whole + knobs.expansion * stiffness
    at_start = compute_bedding(knobs, toe, compression, pretension)[0]
    gain = compute_creep_gain(knobs, dt)
    soft = 1.0 + gain * knobs.creep_share
    compliance, rest = np.empty_like(chain.compliance), np.empty_like(chain.compliance)
    for i in range(len(compliance)):
        tension = state[TENSION, i]
        more, slope = compute_bedding(knobs, toe, compression, tension)
        offset = more - slope * tension - at_start - pretension * soft
        offset += state[CREEP, i] * (1.0 - gain) + too_much
        compliance[i] = chain.compliance[i] * (soft + slope)
        rest[i] = chain.compliance[i] * offset + chain.parted[i]
    return Springs(compliance, rest)


@jit_compile
def compute_bedding(
    knobs: Knobs, toe: float, compression: float, tension: float
) -> tuple[float, float]:
    """Return E(T) - T [N] and its slope at `tension` [N]."""
    more, slope = 0.0, 0.0
    if toe != 0.0:
        left = math.exp(-tension / knobs.toe_tension)
        more += toe * (1.0 - left)
        slope += toe / knobs.toe_tension * left
    above = tension - knobs.compression_threshold
    if compression != 0.0 and above > 0.0:
        more += compression * above * above
        slope += 2.0 * compression * above
    return more, slope


@jit_compile
def compute_creep_gain(knobs: Knobs, dt: float) -> float:
    """Return the fraction of the remaining creep completed in a step of `dt` [s]."""
    return -math.expm1(-dt / knobs.creep_time)


@jit_compile
def advance_creep(chain: Chain, before: float, tension: float, gain: float) -> float:
    """Return the creep [N] of a spring after a step at `tension` [N], with the step's `gain`."""
    final = chain.knobs.creep_share * (tension - chain.pretension)
    return before + gain * (final - before)
