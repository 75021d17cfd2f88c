"""A local model of what a tip meets: the force that the hand will have met when it is known.

A force comes back late, by the network and the lag of the tip's motor, and a hand that moves on is
pushed by what the tip met where the hand was. Against a stiff contact that is active, whatever the
delay. Here the master keeps the local stiffness of the contact, the slope of received force over
received tip travel, and adds what it makes of the way between that place and the hand's:

    f = received + stiffness (x_hand - x_tip)

(a local model of the environment as in Mitra & Niemeyer, "Model-mediated telemanipulation", Int. J.
Robotics Research 27, 2008, 253-262). The model is not trusted: the addition only ever resists the
hand's motion, never turns the force round, and fades with `WASHOUT`, so that a tip that stays
behind the hand is no force. A constant load has no stiffness, and is not resisted.

The slope is a regression with a memory over the tip's way, not over time: at rest nothing is
forgotten, and noise does not wear it out.
"""

import math

from estimator.compiled import jit_compile
from estimator.structs import F64, Flag, Struct

REGRESSION_STEP = 2e-5  # [m] the tip's way from one point of the regression to the next
REGRESSION_MEMORY = 3e-4  # [m] of the tip's way
TRAVEL_SPREAD_MIN = 5e-6  # [m] spread of the tip's travel below which a slope is noise
WASHOUT = 0.3  # [s]
_MAGNITUDE_MAX = 1e6  # [m], [N] beyond any tip; NaN fails the comparison too


class Contact(Struct):
    """One joint's contact, as the master knows it."""

    is_known: Flag = False  # whether a state of a tip has arrived
    travel: F64 = 0.0  # [m] of the tip, newest
    regression_travel: F64 = 0.0  # [m] the newest point of the regression
    weight: F64 = 0.0  # [m] sum of weights
    mean_travel: F64 = 0.0  # [m] weighted
    mean_force: F64 = 0.0  # [N] weighted
    spread: F64 = 0.0  # [m^3] weighted square of travel about its mean
    product: F64 = 0.0  # [N m^2] weighted product of force and travel about their means
    stiffness: F64 = 0.0  # [N/m] never negative
    ahead: F64 = 0.0  # [m] the hand ahead of the tip, less what has faded
    distance: F64 = 0.0  # [m] the hand ahead of the tip, at the last tick
    has_distance: Flag = False  # whether `distance` is known


@jit_compile
def reset_contact(contact: Contact) -> None:
    """Forget everything: another tip, or none."""
    contact.is_known = False
    contact.has_distance = False
    contact.weight = contact.mean_travel = contact.mean_force = 0.0
    contact.spread = contact.product = contact.stiffness = contact.ahead = 0.0


@jit_compile
def update_contact_model(
    contact: Contact, travel: float, force: float, stiffness_max: float
) -> None:
    """Learn from a tip's travel [m] and the force [N] there.

    The same values again, and values that are implausible or not finite, change nothing.
    `stiffness_max` [N/m] bounds the stiffness.
    """
    if not (abs(travel) < _MAGNITUDE_MAX and abs(force) < _MAGNITUDE_MAX):
        return
    contact.travel = travel
    path = abs(travel - contact.regression_travel)
    if contact.is_known and path < REGRESSION_STEP:
        return
    if not contact.is_known:
        contact.is_known = True
        path = REGRESSION_STEP
    contact.regression_travel = travel
    # weighted means and products, as they are updated by one more point (West 1979)
    decay = math.exp(-path / REGRESSION_MEMORY)
    total = decay * contact.weight + path
    travel_deviation = travel - contact.mean_travel
    force_deviation = force - contact.mean_force
    share = path / total
    product_weight = decay * contact.weight * share
    contact.spread = decay * contact.spread + product_weight * travel_deviation * travel_deviation
    contact.product = decay * contact.product + product_weight * travel_deviation * force_deviation
    contact.mean_travel += share * travel_deviation
    contact.mean_force += share * force_deviation
    contact.weight = total
    slope = contact.product / (contact.spread + total * TRAVEL_SPREAD_MIN * TRAVEL_SPREAD_MIN)
    contact.stiffness = min(max(slope, 0.0), stiffness_max)


@jit_compile
def reset_prediction(contact: Contact) -> None:
    """Begin anew at the next tick: no force is rendered."""
    contact.has_distance = False
    contact.ahead = 0.0


@jit_compile
def predict_force(
    contact: Contact,
    force: float,
    position: float,
    velocity: float,
    stiffness_max: float,
    dt: float,
) -> float:
    """Return the received `force` [N] with what the local model adds; call it once a tick.

    The `force`, positive against pulling, is returned if it is not finite. `position` [m] and
    `velocity` [m/s] are those of the hand, in tip units; only differences of `position` matter.
    `stiffness_max` [N/m] bounds the stiffness, with 0 nothing is added; `dt` [s] is the time since
    the last tick.
    """
    if not contact.is_known or stiffness_max <= 0.0:
        return force
    distance = position - contact.travel
    if contact.has_distance:
        contact.ahead += distance - contact.distance
        contact.ahead *= math.exp(-dt / WASHOUT)
    contact.distance, contact.has_distance = distance, True
    added = contact.stiffness * contact.ahead
    if not added * velocity > 0.0 or not math.isfinite(force):
        return force
    total = force + added
    if force >= 0.0:
        return max(total, 0.0)
    return min(total, 0.0)
