"""The master's port of the coupling: from wanted to admissible forces on the hand.

Scales of motion and force are a transformer between the hand and the coupling, whose units are
those of the tip. The energy ledger uses the hand's own motion, whether or not the tip follows it (a
locked axis, a limit of the workspace), and the force that was actually rendered, in the scale used
then.

A tick has two phases. `add_hand_work` updates the energy ledger for the next command;
`render_force` computes the force, when the slave may have answered that command.
"""

import math

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.structs import F64, Flag, Struct
from master.hand_input import Axes, HandInput, is_all_finite
from teleop import coupling
from teleop.coupling import BilateralSettings, Side
from teleop.messages.messages import MAX_JOINTS


class RenderMemory(Struct):
    """What was rendered in the last tick."""

    is_hand_known: Flag = False  # a hand was seen
    hand: Axes  # [m] its position
    force: Axes  # [N] on the hand, from the coupling
    scale: F64 = 0.0  # force on the hand per force at the tip, at that time


@jit_compile
def add_hand_work(
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
    """Add the work of the hand and of the rendered force since the last tick to the ledger.

    `rendered` is as the last tick left it; `written`, shape (8,), are the forces on the hand [N]
    rendered since, of which the first `axes` are in use. `force_scale` is force on the hand per
    force at the tip, `position_scale` tip travel per hand travel. Forces that are rendered and
    finite are `coupled`.
    """
    # a non-finite position would corrupt the ledger's sums
    is_seen = hand.present and is_all_finite(hand.position, hand.axes)
    position, velocity = np.zeros(MAX_JOINTS), np.zeros(MAX_JOINTS)
    tip_force = np.zeros(MAX_JOINTS)
    for k in range(MAX_JOINTS):
        position[k] = side.requested[k]
        if is_seen and k < hand.axes:
            previous = rendered.hand[k] if rendered.is_hand_known else hand.position[k]
            position[k] += position_scale * (hand.position[k] - previous)
            velocity[k] = position_scale * hand.velocity[k]
            rendered.hand[k] = hand.position[k]
        if k < axes:
            tip_force[k] = _to_tip_force(
                rendered.scale, _compute_coupling_part(written[k], rendered.force[k])
            )
    rendered.is_hand_known = rendered.is_hand_known or is_seen
    lever = force_scale * position_scale
    coupling.count_hand_work(
        settings, side, position, velocity, tip_force, axes, lever, coupled, dt
    )


@jit_compile
def observe_tips(
    settings: BilateralSettings,
    side: Side,
    force_scale: float,
    position: Array,
    requested: Array,
    axes: int,
) -> None:
    """Take over the tips' travels [m] and the forces [N] on the hand that a new state asks for."""
    tip_force = np.zeros(MAX_JOINTS)
    for k in range(axes):
        tip_force[k] = _to_tip_force(force_scale, requested[k])
    coupling.update_contact_models(settings, side, position, tip_force, axes)


@jit_compile
def render_force(
    settings: BilateralSettings,
    side: Side,
    force_scale: float,
    requested: Array,
    axes: int,
    coupled: bool,
    out: Array,
) -> None:
    """Write the forces [N] of the coupling on the hand to the first `axes` of `out`.

    `requested`, shape (8,), are the forces on the hand [N] wanted now. They are what is written
    unless `coupled`: forces are rendered and `add_hand_work` was called as coupled in this tick.
    """
    for k in range(axes):
        out[k] = requested[k]
    if not coupled:
        return
    tip_force, granted_force = np.zeros(MAX_JOINTS), np.zeros(MAX_JOINTS)
    for k in range(axes):
        tip_force[k] = _to_tip_force(force_scale, requested[k])
    coupling.render_force(settings, side, tip_force, axes, granted_force)
    for k in range(axes):
        if force_scale != 0.0:
            out[k] = -force_scale * granted_force[k]


@jit_compile
def store_rendered_force(
    rendered: RenderMemory, force_scale: float, force: Array, axes: int
) -> None:
    """Store the forces of the coupling and their scale."""
    for k in range(axes):
        rendered.force[k] = force[k]
    rendered.scale = force_scale


@jit_compile
def _compute_coupling_part(written: float, requested: float) -> float:
    """Return the coupling's part of a `written` force: at most the `requested` one."""
    if not math.isfinite(requested):
        return 0.0
    return min(max(written, min(requested, 0.0)), max(requested, 0.0))


@jit_compile
def _to_tip_force(scale: float, force: float) -> float:
    return -force / scale if scale > 0.0 else 0.0
