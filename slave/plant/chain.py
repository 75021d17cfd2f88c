"""An elastic tendon in its sheath, as a chain of springs and dry-friction nodes.

The sheath is cut into n cells. The friction of a cell acts in its middle, on a node of the tendon;
the tendon between two nodes is a spring that can only pull. Motion is slow, so every node is in
balance. With u the displacement of the tendon (positive towards the housing), T_i the tension of
the spring behind node i, c_i its compliance, and phi_i = mu dtheta_i the friction coefficient times
the bend of the node's cell,

    T_i = max(0, pretension + (u_i - u_{i+1}) / c_i)                    Hooke
    f_i = T_{i-1} - T_i,   |f_i| <= phi_i (T_{i-1} + T_i) / 2           Coulomb, on the bend's force
    f_i at its upper limit where the node moves towards the housing, at its lower one where it
    moves towards the tip, anything between where it stays.

Nothing here knows how tension varies along a sheath; that is what an estimator assumes and what
a plant must not.

The balance is solved exactly and without iteration. Everything on the housing's side of a point,
with the motor where it is, can only answer in one way: with a tension that falls, piecewise
linearly, as the point moves towards the housing. That response is carried from the motor to the
tip (a spring shears it, a node's friction scales its two halves and leaves a step between them),
meets the load there, and the nodes are then placed backwards from the tip.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from slave.plant.load import Load, load_force
from teleop.config import MAY_BE_INFINITE

Array = NDArray[np.float64]

FRICTION_MAX = 1.0  # of one node: beyond it cells are too coarse, and at 2 a chain would jam
PASSES = 100  # of Newton's method at the tip; one for each piece of the load is needed


@dataclass(frozen=True, slots=True)
class SectionConfig:
    """A stretch of sheath of constant bend radius."""

    length: float  # [m]
    radius: float = field(default=math.inf, metadata=MAY_BE_INFINITE)  # [m] .inf = straight

    def __post_init__(self) -> None:
        """Refuse a section without extent."""
        if not 0.0 < self.length <= 100.0:
            raise ValueError("length: must be above 0 and at most 100 m")
        if not self.radius > 0.0:
            raise ValueError("radius: must be above 0 m")


@dataclass(frozen=True, slots=True)
class SheathConfig:
    """A tendon in its sheath; the one of Phee et al. 2009 as far as it is known, K about 1."""

    sections: tuple[SectionConfig, ...] = (SectionConfig(1.5, 0.225),)  # housing to tip
    friction: float = 0.15  # mu, dimensionless, of tendon on sheath
    axial_stiffness: float = 9000.0  # EA [N] of tendon and sheath in series
    nodes: int = 60  # cells that the sheath is cut into

    def __post_init__(self) -> None:
        """Refuse a sheath that cannot be."""
        if not self.sections:
            raise ValueError("sections: at least one is needed")
        if not 0.0 <= self.friction <= 2.0:
            raise ValueError("friction: must be 0 to 2")
        if not 1.0 <= self.axial_stiffness <= 1e7:
            raise ValueError("axial_stiffness: must be 1 to 1e7 N")
        if not 1 <= self.nodes <= 1000:
            raise ValueError("nodes: must be 1 to 1000")
        most = build_chain(self, 0.0).friction.max()
        if most >= FRICTION_MAX:
            needed = math.ceil(self.nodes * most / FRICTION_MAX) + 1
            raise ValueError(f"nodes: must be about {needed} to resolve so much friction")


class Chain(NamedTuple):
    """One tendon in one sheath: n nodes and n + 1 springs, from the housing to the tip."""

    compliance: Array  # c_i [m/N] shape (n + 1,)
    friction: Array  # phi_i [-] shape (n,), each below FRICTION_MAX
    pretension: float  # [N] in every spring while all displacements are zero


class Response(NamedTuple):
    """How the housing's side answers at the tip: `corners`, then a ray without end.

    The tension is zero from `place[0]` towards the housing, runs through the corners, and rises
    for ever by one newton each `-ray` metres towards the tip.
    """

    place: Array  # [m] falling
    tension: Array  # [N] rising from zero
    corners: int  # how many entries of the two are in use
    ray: float  # [m/N] < 0
    slack: Array  # [m] shape (n,): where each node's own housing side goes slack
    held: Array  # [N] shape (n,): the tension on a node's housing side if the node stays


def build_chain(config: SheathConfig, pretension: float) -> Chain:
    """Cut a sheath into cells of like length, at least one in each section.

    `pretension` [N] is the tension all along the tendon while all displacements are zero.
    """
    length = np.array([section.length for section in config.sections])
    radius = np.array([section.radius for section in config.sections])
    cells = np.maximum(1, np.round(config.nodes * length / length.sum())).astype(np.int64)
    cell = np.repeat(length / cells, cells)
    half = 0.5 * cell / config.axial_stiffness
    return Chain(
        compliance=np.concatenate([half, [0.0]]) + np.concatenate([[0.0], half]),
        friction=config.friction * cell / np.repeat(radius, cells),
        pretension=pretension,
    )


@compiled
def tensions(chain: Chain, position: Array) -> Array:
    """Return the tension of each spring [N], shape (n + 1,).

    `position` [m], shape (n + 2,), holds the motor, the nodes and the tip.
    """
    stretch = position[:-1] - position[1:]
    return np.maximum(0.0, chain.pretension + stretch / chain.compliance)


@compiled
def respond(chain: Chain, before: Array, motor: float) -> Response:
    """Carry the response of the housing's side from the motor at `motor` [m] to the tip.

    `before` [m], shape (n + 2,), is where motor, nodes and tip were: each node is held by friction
    where it was, or drags from there.
    """
    n = len(chain.friction)
    place = np.empty(2 * n + 1)
    tension = np.empty(2 * n + 1)
    slack = np.empty(n)
    held = np.zeros(n)
    place[0], tension[0], count, ray = motor, 0.0, 1, 0.0
    for i in range(n):
        for j in range(count):
            place[j] -= chain.compliance[i] * (tension[j] - chain.pretension)
        ray -= chain.compliance[i]
        slack[i] = place[0]
        ratio = (2.0 + chain.friction[i]) / (2.0 - chain.friction[i])
        stay = before[i + 1]
        split = 0  # corners before it lie on the housing's side of `stay`
        while split < count and place[split] > stay:
            split += 1
        if split > 0:
            if split < count:
                slope = (tension[split] - tension[split - 1]) / (place[split] - place[split - 1])
            else:
                slope = 1.0 / ray
            held[i] = tension[split - 1] + (stay - place[split - 1]) * slope
            for j in range(count - 1, split - 1, -1):
                place[j + 2] = place[j]
                tension[j + 2] = tension[j]
            place[split : split + 2] = stay
            tension[split : split + 2] = held[i]
            count += 2
            for j in range(split + 1):
                tension[j] /= ratio
            split += 1
        for j in range(split, count):
            tension[j] *= ratio
        ray /= ratio
    for j in range(count):
        place[j] -= chain.compliance[n] * (tension[j] - chain.pretension)
    ray -= chain.compliance[n]
    return Response(place, tension, count, ray, slack, held)


@compiled
def meet(response: Response, load: Load) -> tuple[float, float]:
    """Return where [m] and with what tension [N] the tendon's response balances `load`."""
    place, tension = response.place, response.tension
    j = 0
    while j < response.corners and tension[j] < load_force(load, place[j])[0]:
        j += 1
    if j == 0:  # slack: the load rests where it pulls no more
        base, tension_base, slope = place[0], 0.0, 0.0
        low, high = place[0], np.inf
    elif j < response.corners:
        base, tension_base = place[j], tension[j]
        if place[j - 1] == base:  # a stuck node: the tip stays, whatever the load within the step
            return base, load_force(load, base)[0]
        slope = (tension[j] - tension[j - 1]) / (base - place[j - 1])
        low, high = base, place[j - 1]
    else:
        base, tension_base, slope = place[j - 1], tension[j - 1], 1.0 / response.ray
        low, high = -np.inf, place[j - 1]
    tip = base
    for _ in range(PASSES):
        force, stiffness = load_force(load, tip)
        step = (tension_base + slope * (tip - base) - force) / (stiffness - slope)
        new = min(max(tip + step, low), high)
        settled = abs(new - tip) <= 1e-15
        tip = new
        if settled:
            break
    return tip, max(0.0, tension_base + slope * (tip - base))


@compiled
def recover(
    chain: Chain, before: Array, response: Response, motor: float, tip: float, tension: float
) -> Array:
    """Place the nodes backwards from the tip; return the positions [m], shape (n + 2,)."""
    n = len(chain.friction)
    position = np.empty(n + 2)
    position[n + 1] = tip
    for i in range(n, 0, -1):
        taut = position[i + 1] + chain.compliance[i] * (tension - chain.pretension)
        ratio = (2.0 + chain.friction[i - 1]) / (2.0 - chain.friction[i - 1])
        held = response.held[i - 1]
        if tension == 0.0:
            position[i] = min(max(before[i], response.slack[i - 1]), taut)
        elif tension * ratio < held:
            position[i] = taut
            tension *= ratio
        elif tension > held * ratio:
            position[i] = taut
            tension /= ratio
        else:
            position[i] = before[i]
            tension = held
    position[0] = motor
    return position


@compiled
def settle(chain: Chain, load: Load, before: Array, motor: float) -> Array:
    """Move the motor end to `motor` [m] and let the tendon and its load come to balance.

    Parameters
    ----------
    before : array, shape (n + 2,)
        Displacements [m] of motor end, nodes and tip before, positive towards the housing; all
        zero is the tendon at rest under its pretension.

    Returns
    -------
    array, shape (n + 2,)
        The displacements after. Work is only ever lost on the way (friction opposes every move).
    """
    response = respond(chain, before, motor)
    tip, tension = meet(response, load)
    return recover(chain, before, response, motor, tip, tension)
