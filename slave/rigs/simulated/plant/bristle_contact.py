"""Tendon chain with elastic-plastic (bristle) friction and dashpots at its nodes.

A bristle between the sheath and a node carries its dry friction elastically until the friction
limit, where its root slips. A node without presliding has a nearly rigid bristle. A dashpot adds b
dx / dt. Both make the tension on a node's tip side a function of that on its housing side and of
its place x:

    T_tip = min(max(T - k (x - root), pull (T + drag) - drag), release (T + drag) - drag)
            - b / dt (x - x_before)

The response is propagated corner by corner, with new corners at the limits. In the backward pass
each node takes its tension from the response of its housing side: the law above would give the
same, but amplifies rounding errors from node to node.
"""

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile, jit_inline
from slave.rigs.simulated.plant.elasticity import Springs
from slave.rigs.simulated.plant.friction import Contacts
from slave.rigs.simulated.plant.response import Curve, Curves, Response, interpolate_curve
from slave.rigs.simulated.plant.tendon import FRICTION, POSITION, TENSION

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
            more = np.empty((n + 1, count))
            place, tension = np.concatenate((place, more), 1), np.concatenate((tension, more), 1)
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
        above = (T + drag) * (1.0 - pull) - bristle * (x - root)
        below = (T + drag) * (release - 1.0) + bristle * (x - root)
        at_low = find_line_zero(above, dT * (1.0 - pull) - bristle * dx, j == corners)
        at_high = find_line_zero(below, dT * (release - 1.0) + bristle * dx, j == corners)
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
def init_bristle_contact(response: Response, state: Array, after: Array) -> None:
    """Compute the nodes backwards from the tip: fill their entries in the new state.

    The tip position and the tension of the last spring are already filled in.
    """
    springs, contacts, inner = response.springs, response.contacts, response.inner
    n = len(contacts.pull)
    tension = after[TENSION, n]
    for i in range(n, 0, -1):
        stay, free, corners = state[POSITION, i], response.slack[i - 1], inner.corners[i - 1]
        loose = after[POSITION, i + 1] + springs.rest[i]
        place = loose + springs.compliance[i] * tension if tension > 0.0 else free
        x, T = inner.place[i - 1, :corners], inner.tension[i - 1, :corners]
        pulled = interpolate_curve(Curve(x, T, inner.ray[i - 1]), place)
        if pulled == 0.0 and tension == 0.0 and contacts.drag == 0.0:
            # its position is undetermined
            place = min(max(stay, free), loose)
        after[POSITION, i], after[TENSION, i] = place, tension
        after[FRICTION, i] = pulled - tension - contacts.dashpot[i - 1] * (place - stay)
        tension = pulled
