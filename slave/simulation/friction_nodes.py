"""Tension response of a tendon through its friction nodes, rigid-plastic or with bristles.

A response is the tension of a tendon at a point over the place of that point: it falls as the point
moves towards the housing. Each node transfers it from its housing side to its tip side.

Rigid-plastic (Coulomb) friction: the response on the housing's side of a node has corners, places x
and tensions T. The spring before the node shears it, x -> x - compliance T - rest. While the node
sticks the response has a step of two new corners; on the housing's side of the step, where the node
slides in, tensions shrink by one ratio, on the tip's side, where it slides out, they grow by
another.

All corners on one side of the step are mapped alike, so each side is a stack of corners with one
affine map, s = T + drag,

    s = q b,   x = a - p b - r

and a spring or a node changes two p, two q and r. Corners change stacks only over the distance
between the steps of two nodes: a sweep is linear in the number of nodes.

Elastic-plastic friction: a bristle between the sheath and a node carries its dry friction
elastically until the friction limit, where its root slips. A node without presliding has a nearly
rigid bristle. A dashpot adds b dx / dt. Both make the tension on a node's tip side a function of
that on its housing side and of its place x:

    T_tip = min(max(T - k (x - root), pull (T + drag) - drag), release (T + drag) - drag)
            - b / dt (x - x_before)

The response is propagated corner by corner, with new corners at the limits. In the backward pass
each node takes its tension from the response of its housing side: the law above would give the
same, but amplifies rounding errors from node to node.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile, jit_inline
from slave.simulation.tendon import FRICTION, POSITION, TENSION, Contacts, Springs


class Curve(NamedTuple):
    """Response of the housing side of a point.

    The tension is zero from `place[0]` towards the housing, piecewise linear through the corners,
    and beyond the last rises by one newton per `-ray` metres towards the tip.
    """

    place: Array  # [m] shape (corners,), falling
    tension: Array  # [N] shape (corners,), rising from zero
    ray: float  # [m/N] < 0


class Curves(NamedTuple):
    """Response curves, one per node."""

    place: Array  # [m] shape (n, room)
    tension: Array  # [N] shape (n, room)
    corners: NDArray[np.int64]  # shape (n,): number in use
    ray: Array  # [m/N] shape (n,)


class Response(NamedTuple):
    """Response of a tendon at its tip in one step, and data to recover its nodes."""

    tip: Curve
    springs: Springs
    contacts: Contacts
    slack: Array  # [m] shape (n,): position of a node without tension from the tip
    held: Array  # [N] shape (n,): on the housing's side of a sticking node
    inner: Curves  # on the housing's side of nodes with bristles


@jit_compile
def find_corner(curve: Curve, place: float) -> int:
    """Return the first corner of a curve at `place` [m] or towards the tip; by bisection."""
    upper, last = 0, len(curve.place)
    while upper < last:
        middle = (upper + last) // 2
        if curve.place[middle] > place:
            upper = middle + 1
        else:
            last = middle
    return upper


@jit_compile
def interpolate_curve(curve: Curve, place: float) -> float:
    """Return the tension [N] of a curve at `place` [m]."""
    places, tensions = curve.place, curve.tension
    upper = find_corner(curve, place)
    if upper == 0:
        return 0.0
    base, tension = places[upper - 1], tensions[upper - 1]
    if upper == len(places):
        return float(tension + (place - base) / curve.ray)
    share = (place - base) / (places[upper] - base)
    return float(tension + share * (tensions[upper] - tension))


# --- rigid-plastic (Coulomb) friction


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
    no_curve = np.empty((0, 0))
    inner = Curves(no_curve, no_curve, np.empty(0, np.int64), np.empty(0))
    return Response(Curve(place, tension, ray), springs, contacts, slack, held, inner)


@jit_inline
def init_coulomb_contact(response: Response, state: Array, new_state: Array) -> None:
    """Compute the nodes backwards from the tip: fill their entries in the new state.

    The tip position and the tension of the last spring are already filled in.
    """
    springs, contacts = response.springs, response.contacts
    n, drag = len(contacts.pull), contacts.drag
    tension = new_state[TENSION, n]
    for i in range(n, 0, -1):
        stay, held, free = state[POSITION, i], response.held[i - 1], response.slack[i - 1]
        pull, release = contacts.pull[i - 1], contacts.release[i - 1]
        loose = new_state[POSITION, i + 1] + springs.rest[i]
        place = loose + springs.compliance[i] * tension
        if loose >= free:  # the tension may be a rounding error off zero, with drag
            place, tension = free, 0.0
        tension_min, tension_max = (held + drag) * pull - drag, (held + drag) * release - drag
        if place > stay and tension < tension_min + ROUNDING_TOLERANCE * (held + drag):
            pulled = max(0.0, (tension + drag) / pull - drag)
        elif place < stay and tension > tension_max - ROUNDING_TOLERANCE * (held + drag):
            pulled = max(0.0, (tension + drag) / release - drag)
        else:
            place, pulled = stay, held
        if pulled == 0.0 and tension == 0.0:  # its position is undetermined
            place = min(max(stay, free), loose)
        new_state[POSITION, i], new_state[TENSION, i] = place, tension
        new_state[FRICTION, i] = pulled - tension
        tension = pulled


# --- elastic-plastic (bristle) friction and dashpots


TENSION_MAX = 1e12  # [N] upper bound of responses: dashpots would make them infinite


@jit_inline
def transfer_bristle_contact(
    springs: Springs, contacts: Contacts, state: Array, proximal: float
) -> Response:
    """Propagate the response from the motor end at `proximal` [m] to the tip."""
    n = len(contacts.pull)
    room = 2 * n + 8
    place, tension = np.empty((n + 1, room)), np.empty((n + 1, room))
    corners, rays, slack = np.empty(n + 1, np.int64), np.empty(n + 1), np.empty(n)
    place[0, 0], tension[0, 0], corners[0], rays[0] = proximal, 0.0, 1, 0.0
    for i in range(n + 1):
        for j in range(corners[i]):
            place[i, j] -= springs.compliance[i] * tension[i, j] + springs.rest[i]
        rays[i] -= springs.compliance[i]
        if i == n:
            break
        stay = state[POSITION, i + 1]
        root = stay - state[FRICTION, i + 1] / contacts.bristle[i]
        x, T = place[i, : corners[i]], tension[i, : corners[i]]
        count = transfer_through_bristle(
            contacts, i, x, T, rays[i], stay, root, place[i + 1], tension[i + 1]
        )
        if count > room:  # a soft bristle sticks, slides and sticks again along one response
            shift = np.empty((n + 1, count))
            place, tension = np.concatenate((place, shift), 1), np.concatenate((tension, shift), 1)
            room += count
            x, T = place[i, : corners[i]], tension[i, : corners[i]]
            transfer_through_bristle(
                contacts, i, x, T, rays[i], stay, root, place[i + 1], tension[i + 1]
            )
        rays[i + 1] = compute_ray(contacts, i, rays[i])
        corners[i + 1] = trim_response(place[i + 1], tension[i + 1], count, rays[i + 1])
        slack[i] = place[i + 1, 0]
    x, T = place[n, : corners[n]].copy(), tension[n, : corners[n]].copy()
    inner = Curves(place[:n], tension[:n], corners[:n], rays[:n])
    return Response(Curve(x, T, rays[n]), springs, contacts, slack, np.empty(0), inner)


@jit_compile
def transfer_through_bristle(
    contacts: Contacts,
    i: int,
    place: Array,
    tension: Array,
    ray: float,
    stay: float,
    root: float,
    new_place: Array,
    new_tension: Array,
) -> int:
    """Propagate a response through node i, last at `stay` [m]; return its number of corners.

    Corners beyond the capacity are only counted.
    """
    pull, release, drag = contacts.pull[i], contacts.release[i], contacts.drag
    bristle, dashpot = contacts.bristle[i], contacts.dashpot[i]
    new, room, corners = 0, len(new_place), len(place)
    x, T = max(place[0], root, stay), 0.0
    for j in range(corners + 1):
        dx, dT = ray, 1.0
        if j < corners:
            dx, dT = place[j] - x, tension[j] - T
        # distance of the elastic tension from its lower and its upper limit
        upper_excess = (T + drag) * (1.0 - pull) - bristle * (x - root)
        lower_excess = (T + drag) * (release - 1.0) + bristle * (x - root)
        at_low = find_line_zero(upper_excess, dT * (1.0 - pull) - bristle * dx, j == corners)
        at_high = find_line_zero(lower_excess, dT * (release - 1.0) + bristle * dx, j == corners)
        for along in (0.0, min(at_low, at_high), max(at_low, at_high)):
            if along == np.inf:
                break
            if new < room:
                at, pulled = x + along * dx, T + along * dT
                low, high = (pulled + drag) * pull - drag, (pulled + drag) * release - drag
                leaning = min(max(pulled - bristle * (at - root), low), high)
                if along == at_low:  # a stiff bristle would amplify rounding errors
                    leaning = low
                elif along == at_high:
                    leaning = high
                new_place[new], new_tension[new] = at, leaning - dashpot * (at - stay)
            new += 1
        if j < corners:
            x, T = place[j], tension[j]
    return new


@jit_compile
def find_line_zero(value: float, rate: float, endless: bool) -> float:
    """Return the zero of a line from `value` within (0, 1) or above 0; infinity if none."""
    end = rate if endless else value + rate
    if value < 0.0 < end or end < 0.0 < value:
        return -value / rate
    return np.inf


@jit_compile
def compute_ray(contacts: Contacts, i: int, ray: float) -> float:
    """Return the ray [m/N] of a response behind node i."""
    release, bristle = contacts.release[i], contacts.bristle[i]
    slides = release - 1.0 + bristle * ray < 0.0
    steep = release if slides else 1.0 - bristle * ray  # dT after over dT before
    return float(ray / (steep - contacts.dashpot[i] * ray))


@jit_compile
def trim_response(place: Array, tension: Array, corners: int, ray: float) -> int:
    """Cut a response at the start of its positive part; return the remaining corners."""
    while corners > 1 and tension[corners - 2] > TENSION_MAX:
        corners -= 1
    if tension[corners - 1] > TENSION_MAX:
        a, b = corners - 2, corners - 1
        place[b] = place[a] + (TENSION_MAX - tension[a]) / (tension[b] - tension[a]) * (
            place[b] - place[a]
        )
        tension[b] = TENSION_MAX
    first = 0  # with a tension
    while first < corners and tension[first] <= 0.0:
        first += 1
    last = first - 1  # without
    if tension[last] < 0.0:
        if first == corners:
            place[last] -= tension[last] * ray
        else:
            share = tension[last] / (tension[last] - tension[first])
            place[last] += share * (place[first] - place[last])
        tension[last] = 0.0
    if last > 0:
        for j in range(last, corners):
            place[j - last], tension[j - last] = place[j], tension[j]
    return corners - last


@jit_inline
def init_bristle_contact(response: Response, state: Array, new_state: Array) -> None:
    """Compute the nodes backwards from the tip: fill their entries in the new state.

    The tip position and the tension of the last spring are already filled in.
    """
    springs, contacts, inner = response.springs, response.contacts, response.inner
    n = len(contacts.pull)
    tension = new_state[TENSION, n]
    for i in range(n, 0, -1):
        stay, free, corners = state[POSITION, i], response.slack[i - 1], inner.corners[i - 1]
        loose = new_state[POSITION, i + 1] + springs.rest[i]
        place = loose + springs.compliance[i] * tension if tension > 0.0 else free
        x, T = inner.place[i - 1, :corners], inner.tension[i - 1, :corners]
        pulled = interpolate_curve(Curve(x, T, inner.ray[i - 1]), place)
        if pulled == 0.0 and tension == 0.0 and contacts.drag == 0.0:
            # its position is undetermined
            place = min(max(stay, free), loose)
        new_state[POSITION, i], new_state[TENSION, i] = place, tension
        new_state[FRICTION, i] = pulled - tension - contacts.dashpot[i - 1] * (place - stay)
        tension = pulled
