"""Tendon chain with rigid-plastic (Coulomb) friction at its nodes.

The response on the housing's side of a node has corners, places x and tensions T. The spring before
the node shears it, x -> x - compliance T - rest. While the node sticks the response has a step of
two new corners; on the housing's side of the step, where the node slides in, tensions shrink by one
ratio, on the tip's side, where it slides out, they grow by another.

All corners on one side of the step are mapped alike, so each side is a stack of corners with one
affine map, s = T + drag,

    s = q b,   x = a - p b - r

and a spring or a node changes two p, two q and r. Corners change stacks only over the distance
between the steps of two nodes: a sweep is linear in the number of nodes.
"""

from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile, jit_inline
from slave.rigs.simulated.plant.elasticity import Springs
from slave.rigs.simulated.plant.friction import Contacts
from slave.rigs.simulated.plant.response import Curve, Curves, Response
from slave.rigs.simulated.plant.tendon import FRICTION, POSITION, TENSION

ROUNDING_TOLERANCE = 1e-12  # of a tension: tolerance between sticking and sliding
P, Q, R = 0, 1, 2  # of a map


class CornerStack(NamedTuple):
    """A stack of corners with an affine map; its top is next to the step."""

    a: Array
    b: Array
    map: Array  # p [m/N], q, r [m]


@jit_compile
def create_corner_stack(room: int) -> CornerStack:
    """Return a side without corners and with the identity map."""
    return CornerStack(np.empty(room), np.empty(room), np.array([0.0, 1.0, 0.0]))


@jit_compile
def get_corner(side: CornerStack, j: int) -> tuple[float, float]:
    """Return x [m] and s [N] of corner j."""
    s = side.map[Q] * side.b[j]
    return side.a[j] - side.map[P] * side.b[j] - side.map[R], s


@jit_compile
def set_corner(side: CornerStack, j: int, x: float, s: float) -> None:
    """Set corner j to (x, s)."""
    side.b[j] = s / side.map[Q]
    side.a[j] = x + side.map[P] * side.b[j] + side.map[R]


@jit_compile
def shear_corners(side: CornerStack, compliance: float, rest: float) -> None:
    """Map all corners through a spring."""
    side.map[P] += compliance * side.map[Q]
    side.map[R] += rest


@jit_inline
def transfer_coulomb_contact(
    springs: Springs, contacts: Contacts, state: Array, proximal: float
) -> Response:
    """Propagate the response from the motor end at `proximal` [m] to the tip."""
    n, drag = len(contacts.pull), contacts.drag
    slack, held = np.empty(n), np.empty(n)
    housing, tip = create_corner_stack(2 * n + 1), create_corner_stack(2 * n + 1)
    bottom, top, out, ray = 0, 1, 0, 0.0  # housing's corners from bottom to top, and tip's
    set_corner(housing, bottom, proximal, drag)
    for i in range(n + 1):
        compliance, rest = springs.compliance[i], springs.rest[i] - springs.compliance[i] * drag
        shear_corners(housing, compliance, rest)
        shear_corners(tip, compliance, rest)
        ray -= compliance
        if i == n:
            break
        stay = state[POSITION, i + 1]
        while top > bottom and get_corner(housing, top - 1)[0] <= stay:
            x, s = get_corner(housing, top - 1)
            set_corner(tip, out, x, s)
            top, out = top - 1, out + 1
        while out > 0 and get_corner(tip, out - 1)[0] > stay:
            x, s = get_corner(tip, out - 1)
            set_corner(housing, top, x, s)
            top, out = top + 1, out - 1

        pressed = drag  # s on the housing's side while the node sticks
        if top > bottom:
            x, pressed = get_corner(housing, top - 1)
            next_x, s = get_corner(tip, out - 1) if out > 0 else (x + ray, pressed + 1.0)
            if next_x < x:
                pressed += (stay - x) / (next_x - x) * (s - pressed)
        held[i] = max(0.0, pressed - drag)
        set_corner(housing, top, stay, pressed)
        set_corner(tip, out, stay, pressed)
        top, out = top + 1, out + 1
        housing.map[Q] *= contacts.pull[i]
        tip.map[Q] *= contacts.release[i]
        ray /= contacts.release[i]

        while out > 0 and get_corner(tip, out - 1)[1] <= drag:  # zero tension: slack
            x, s = get_corner(tip, out - 1)
            set_corner(housing, top, x, s)
            top, out = top + 1, out - 1
        while bottom + 1 < top and get_corner(housing, bottom + 1)[1] <= drag:
            bottom += 1
        x, s = get_corner(housing, bottom)
        if s < drag:  # the response begins between corners
            next_x, next_s = x + ray, s + 1.0
            if bottom + 1 < top:
                next_x, next_s = get_corner(housing, bottom + 1)
            elif out > 0:
                next_x, next_s = get_corner(tip, out - 1)
            x += (drag - s) / (next_s - s) * (next_x - x)
            set_corner(housing, bottom, x, drag)
        slack[i] = x

    corners = top - bottom + out
    place, tension = np.empty(corners), np.empty(corners)
    for j in range(top - bottom):
        place[j], tension[j] = get_corner(housing, bottom + j)
    for j in range(out):
        place[corners - 1 - j], tension[corners - 1 - j] = get_corner(tip, j)
    for j in range(1, corners):
        tension[j] -= drag
    tension[0] = 0.0
    none = np.empty((0, 0))
    inner = Curves(none, none, np.empty(0, np.int64), np.empty(0))
    return Response(Curve(place, tension, ray), springs, contacts, slack, held, inner)


@jit_inline
def init_coulomb_contact(response: Response, state: Array, after: Array) -> None:
    """Compute the nodes backwards from the tip: fill their entries in the new state.

    The tip position and the tension of the last spring are already filled in.
    """
    springs, contacts = response.springs, response.contacts
    n, drag = len(contacts.pull), contacts.drag
    tension = after[TENSION, n]
    for i in range(n, 0, -1):
        stay, held, free = state[POSITION, i], response.held[i - 1], response.slack[i - 1]
        pull, release = contacts.pull[i - 1], contacts.release[i - 1]
        loose = after[POSITION, i + 1] + springs.rest[i]
        place = loose + springs.compliance[i] * tension
        if loose >= free:  # the tension may be a rounding error off zero, with drag
            place, tension = free, 0.0
        least, most = (held + drag) * pull - drag, (held + drag) * release - drag
        if place > stay and tension < least + ROUNDING_TOLERANCE * (held + drag):
            pulled = max(0.0, (tension + drag) / pull - drag)
        elif place < stay and tension > most - ROUNDING_TOLERANCE * (held + drag):
            pulled = max(0.0, (tension + drag) / release - drag)
        else:
            place, pulled = stay, held
        if pulled == 0.0 and tension == 0.0:  # its position is undetermined
            place = min(max(stay, free), loose)
        after[POSITION, i], after[TENSION, i] = place, tension
        after[FRICTION, i] = pulled - tension
        tension = pulled
