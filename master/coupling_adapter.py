"""The coupling at the master: from forces wanted on the hand to forces it can be given.

Scales of motion and force are a transformer between the hand and the coupling, whose units are
those of the tip. What the hand does is counted by the hand's own motion, whether or not the tip is
asked to follow it (a locked axis, a limit of the workspace), and by the force that was really
rendered, in the scale that it was rendered with.

A tick has two phases. `count_hand` does all that the next command must tell of the energy ledger;
`render` finds the force, when the slave may have answered that command.
"""

import math

import numpy as np

from estimator.array_types import Array
from estimator.compiled import compiled
from estimator.records import F64, Flag, Record
from master.hand_input import Axes, HandInput, all_finite
from teleop import coupling
from teleop.coupling import BilateralSettings, Side
from teleop.messages import MAX_JOINTS


class RenderMemory(Record):
    """What was rendered in the tick before."""

    hand_known: Flag = False  # a hand was seen
    hand: Axes  # [m] where it was
    force: Axes  # [N] on the hand that the coupling had asked for
    scale: F64 = 0.0  # force on the hand per force at the tip, with it


@compiled
def count_hand(
    settings: BilateralSettings,
    side: Side,
    rendered: RenderMemory,
    hand: HandInput,
    force_scale: float,
    position_scale: float,
    written: Array,
    axes: int,
    coupled: bool,
    dt: float,
) -> None:
    """Count what the hand did since the last tick, and what it was given.

    Parameters
    ----------
    rendered : RenderMemory
        As the last tick left it.
    force_scale, position_scale : float
        Force on the hand per force at the tip; tip travel per hand travel.
    written : array of shape (8,)
        Forces on the hand [N] rendered since the last tick; the first `axes` are in use.
    coupled : bool
        Whether forces are rendered, and will be numbers as far as is known.
    """
    # a position that is not finite would stay in the ledger's sums for ever
    seen = hand.present and all_finite(hand.position, hand.axes)
    place, velocity = np.zeros(MAX_JOINTS), np.zeros(MAX_JOINTS)
    at_tip = np.zeros(MAX_JOINTS)
    for k in range(MAX_JOINTS):
        place[k] = side.requested[k]
        if seen and k < hand.axes:
            before = rendered.hand[k] if rendered.hand_known else hand.position[k]
            place[k] += position_scale * (hand.position[k] - before)
            velocity[k] = position_scale * hand.velocity[k]
            rendered.hand[k] = hand.position[k]
        if k < axes:
            at_tip[k] = _at_tip(rendered.scale, _part(written[k], rendered.force[k]))
    rendered.hand_known = rendered.hand_known or seen
    lever = force_scale * position_scale
    coupling.count_hand(settings, side, place, velocity, at_tip, axes, lever, coupled, dt)


@compiled
def render(
    settings: BilateralSettings,
    side: Side,
    force_scale: float,
    wanted: Array,
    axes: int,
    coupled: bool,
    out: Array,
) -> None:
    """Write the forces [N] that the coupling gives the hand to the first `axes` of `out`.

    Parameters
    ----------
    wanted : array of shape (8,)
        Forces on the hand [N] wanted now.
    coupled : bool
        Whether forces may reach the hand, and the hand was counted as coupled in this tick; if not,
        `out` is what is wanted.
    """
    for k in range(axes):
        out[k] = wanted[k]
    if not coupled:
        return
    at_tip, granted_force = np.zeros(MAX_JOINTS), np.zeros(MAX_JOINTS)
    for k in range(axes):
        at_tip[k] = _at_tip(force_scale, wanted[k])
    coupling.render(settings, side, at_tip, axes, granted_force)
    for k in range(axes):
        if force_scale != 0.0:
            out[k] = -force_scale * granted_force[k]


@compiled
def remember(rendered: RenderMemory, force_scale: float, force: Array, axes: int) -> None:
    """Remember the forces that the coupling asked for, and their scale."""
    for k in range(axes):
        rendered.force[k] = force[k]
    rendered.scale = force_scale


@compiled
def _part(written: float, requested: float) -> float:
    """Return how much of a `written` force was the coupling's: no more than it `requested` for."""
    if not math.isfinite(requested):
        return 0.0
    return min(max(written, min(requested, 0.0)), max(requested, 0.0))


@compiled
def _at_tip(scale: float, force: float) -> float:
    return -force / scale if scale > 0.0 else 0.0
