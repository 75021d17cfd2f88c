"""What effects add to the closed law in the loop: the law on nodes with them, less without them.

Both tendons of nodes (estimator.extended) are pulled with the tension that drives the closed law,
so what nodes and closed law have in common, and whoever drives, cancels out of their difference.

Friction that depends on speed wants to know how fast the tendon slides, which the tension does not
tell:

* Viscous friction is part of each step's balance, and the tip's travel with it. What the tip pulls
  at is not what it pulled at on the bench, so it is learnt: the travel at the tip, measured less
  elongation, over the tension there, of changes in the last seconds.
* Stribeck's makes such a balance unstable. It is told the speed: measured travel less elongation up
  to each contact, averaged.

A sample without travel goes by what was learnt before, and by the speeds of the steps.
"""

import math

import numpy as np

from estimator import extended
from estimator.compiled import compiled
from estimator.extended import SAMPLE
from estimator.memory import Array
from estimator.nodes import NODES

SPEED_OVER = 0.02  # [s] over which speeds are averaged
QUICK, SLOW = 0.02, 2.0  # [s] between which changes at the tip count
LEARNT_OVER = 2.0  # [s] for which they count
CLOSED_OVER = 10.0  # [s]
LEAST = 1e-4  # [N^2 s] of changes that weigh as much as the bench
ONCE = 1.0  # a step is not divided: it must end in time
SOFTEST = 5e-3  # [m/N] of what the tip pulls at
JUMP = 0.01  # [m] in a sample: no motion
LONGEST = 1.0  # [m] that effects stretch a tendon

# Where the constants are: friction, what the tip pulled at on the bench, and both tendons
_FRICTION, _BENCH, _PLAIN = range(3)
_EXTENDED = _PLAIN + extended.CONSTANTS
CONSTANTS = _EXTENDED + extended.CONSTANTS

# Where the parts of a state are
(
    TENSION,  # [N] T_out with the effects less without
    ELONGATION,  # [m] e with the effects less without
    TRAVEL,  # [m] q_p with the effects less without, the tip pulling at the same
    UNHEARD,  # [s] since the last push, for which samples were refused
    _LEARNS,  # the sample before had a travel, and the tendon was taut
    _COMPLIANCE,  # [m/N] of what the tip pulls at
    _OFFSET,  # [m] of where it would be without tension
    _QUICK_Q,  # [m] and [N] at the tip, averaged over QUICK and over SLOW
    _QUICK_T,
    _SLOW_Q,
    _SLOW_T,
    _QT,  # [m N s] and [N^2 s]: sums of products of changes
    _TT,
    _PLACES,  # [m] of each contact, averaged
) = range(14)
_OF_PLAIN = _PLACES + NODES - 1
_OF_EXTENDED = _OF_PLAIN + extended.STATE
STATE = _OF_EXTENDED + extended.STATE
"""Length of the flat array that is remembered."""


def constants_of(plain: extended.Physics, with_effects: extended.Physics) -> Array:
    """Return what `push` needs to know, as one flat array."""
    bench = [float(plain.friction[0]), plain.tip_compliance]
    lines = (extended.constants_of(plain), extended.constants_of(with_effects))
    return np.concatenate([bench, *lines])


def start(constants: Array) -> Array:
    """Return the state of a tendon that has been slack so far."""
    state = np.empty(STATE)
    _reset(constants, state)
    return state


@compiled
def push(constants: Array, state: Array, T: float, q: float, dt: float) -> None:
    """Pull with `T` [N], the motor being at `q` [m] or NaN, and note what effects make of it.

    In place. Should numbers run away, the effects are forgotten until the tendon is pulled again.
    """
    told = not math.isnan(q)
    dt += state[UNHEARD]
    state[UNHEARD] = 0.0
    plain, with_effects = state[_OF_PLAIN:_OF_EXTENDED], state[_OF_EXTENDED:]
    sample = np.empty((1, SAMPLE))
    sample[0, extended.DT], sample[0, extended.FRICTION] = dt, constants[_FRICTION]
    sample[0, extended.STRETCH], sample[0, extended.OFFSET] = 0.0, 0.0
    sample[0, extended.COMPLIANCE] = constants[_BENCH]
    sample[0, extended.TARGET] = T
    sample[0, extended.SPEED] = abs(T - plain[0]) / dt if dt > 0.0 else 0.0
    none = np.empty(0)
    without = extended.advance(constants[_PLAIN:_EXTENDED], plain, sample, none, True, ONCE)[0]
    speeds = none
    if told and constants[_EXTENDED + extended.STRIBECK] != 0.0:
        speeds = _speeds(state, plain, q, dt)
    sample[0, extended.OFFSET], sample[0, extended.COMPLIANCE] = state[_OFFSET], state[_COMPLIANCE]
    beside = constants[_EXTENDED:]
    after = extended.advance(beside, with_effects, sample, speeds, True, ONCE)[0]
    T_out, q_d = after[1], after[3]
    elongation = after[2] - q_d
    change, longer = T_out - without[1], elongation - (without[2] - without[3])
    if not (math.isfinite(change) and abs(longer) < LONGEST):
        _reset(constants, state)
        return
    state[TRAVEL] += longer - state[ELONGATION]
    if constants[_EXTENDED + extended.VISCOSITY] != 0.0:
        state[TRAVEL] += state[_COMPLIANCE] * (change - state[TENSION])
        # the sum of changes with a compliance that is learnt does not close by itself
        closed = longer + state[_COMPLIANCE] * change
        state[TRAVEL] += -math.expm1(-dt / CLOSED_OVER) * (closed - state[TRAVEL])
    state[TENSION], state[ELONGATION] = change, longer
    _learn(constants, state, T > 0.0 and told, q - elongation, T_out, q_d, dt)


@compiled
def _speeds(state: Array, plain: Array, q: float, dt: float) -> Array:
    """Return how fast the tendon slides over each contact [m/s], by the motor's travel."""
    places = state[_PLACES:_OF_PLAIN]
    speeds = np.empty(NODES - 1)
    fresh = state[_LEARNS] == 0.0
    share = -math.expm1(-dt / SPEED_OVER)
    place = q
    for j in range(NODES - 1):
        place -= plain[extended.LENGTHS + j]
        if fresh:
            places[j] = place
        places[j] += share * (place - places[j])
        speeds[j] = abs(place - places[j]) / SPEED_OVER
    return speeds


@compiled
def _learn(
    constants: Array, state: Array, taut: bool, q: float, T: float, at: float, dt: float
) -> None:
    """Note that the tip is measured at `q` under `T` [N]; what it pulls at leaves it `at` [m]."""
    if taut and state[_LEARNS] != 0.0 and abs(q - state[_QUICK_Q]) < JUMP:
        quick, slow = -math.expm1(-dt / QUICK), -math.expm1(-dt / SLOW)
        state[_QUICK_Q] += quick * (q - state[_QUICK_Q])
        state[_QUICK_T] += quick * (T - state[_QUICK_T])
        state[_SLOW_Q] += slow * (q - state[_SLOW_Q])
        state[_SLOW_T] += slow * (T - state[_SLOW_T])
        dT = state[_QUICK_T] - state[_SLOW_T]
        dq = min(max(state[_QUICK_Q] - state[_SLOW_Q], -SOFTEST * abs(dT)), SOFTEST * abs(dT))
        kept = math.exp(-dt / LEARNT_OVER)
        state[_QT] = kept * state[_QT] + dq * dT * dt
        state[_TT] = kept * state[_TT] + dT * dT * dt
        learnt = (state[_QT] + LEAST * constants[_BENCH]) / (state[_TT] + LEAST)
        state[_COMPLIANCE] = min(max(learnt, 0.0), SOFTEST)
        state[_OFFSET] = at - state[_COMPLIANCE] * T
    elif taut:
        state[_QUICK_Q] = state[_SLOW_Q] = q
        state[_QUICK_T] = state[_SLOW_T] = T
    state[_LEARNS] = 1.0 if taut else 0.0


@compiled
def _reset(constants: Array, state: Array) -> None:
    """Begin again with a slack tendon."""
    state[:] = 0.0
    state[_COMPLIANCE] = constants[_BENCH]
    state[_OF_PLAIN:_OF_EXTENDED] = extended.start(constants[_PLAIN:_EXTENDED], 0.0, 0.0, 0.0)
    state[_OF_EXTENDED:] = extended.start(constants[_EXTENDED:], 0.0, 0.0, 0.0)
