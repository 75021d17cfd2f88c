"""How tendons run through the joints of an arm, and what that makes of travels and torques.

A distal tendon passes proximal joints: each of them pulls it in or pays it out, bends it, and is
loaded by it. `Routing` describes this; `prepare` turns it into what a tick needs.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.array_types import Array
from estimator.law.sheath import Sheath

MAX_JOINTS, MAX_TENDONS = 8, 16
MAX_K = 20.0
"""Largest friction of all passed joints of a tendon together, at its given wraps."""

SHEATH_ELEMENTS = 12
"""Friction elements of a sheath, at least."""

RANK_TOLERANCE = 1e-9  # of singular values, relative to the largest


class RoutingError(ValueError):
    """An impossible routing; the message names the field, the tendon or joint, and the remedy."""


@dataclass(frozen=True, eq=False)
class Routing:
    """Tendons over the joints of an arm; tables have the shape (tendons, joints).

    Tables are given as arrays or lists and kept as arrays. A single number stands for all entries.
    Tendons and joints count from 0 in tables and in messages.

    Attributes
    ----------
    radii
        R [m]: travel of the tendon towards the motor per rad of the joint; with its sign, so a
        tension T turns the joint with R T. For a curved section, the distance of the tendon from
        the neutral line, by the section's bend angle.
    friction
        Coulomb coefficient at the guide of each passed joint. 0 where the tendon is anchored.
    wrap
        phi_0 [rad]: bend of the tendon over the guide at joint angle 0.
    side
        The bend is |phi_0 + side angle|; by default against the sign of R, as over a pin.
    guide
        "proximal": a pin or pulley fixed to the link before the joint, so the tension behind it
        loads the joint. "distal": fixed to the link after it, so the tension before it does.
        "spread": a curved section, in which friction and load spread over `length`.
    span
        [m] of tendon from this guide to the next or to the anchor.
    length
        [m] of tendon in a curved section; a pin has |R| times the wrap.
    axial_stiffness
        EA [N] of the tendon.
    order
        For each tendon, the joints in the order in which it passes them; by default all joints with
        a radius or a wrap, in their order.
    spring_stiffness, spring_angle
        Springs at the joints, shape (joints,), or a number: stiffness [N m/rad] and angle of zero
        torque [rad]. A joint with a spring needs no antagonist.
    partner
        For each joint the other bend of the same curved section, -1 without one: the bend over its
        guides is the root of the sum of both squares.
    pin_elements, bend_elements
        Friction elements of a pin, and of a curved section. A step takes less time with fewer.
    friction_error, compliance_error
        Relative errors that intervals allow for, of friction and of the tendon's compliance.
    angle_error
        [rad] largest error of joint angles that intervals allow for, not accumulated. Motion
        within it is not taken for motion.
    """

    radii: Any
    friction: Any = 0.0
    wrap: Any = 0.0
    side: Any = None
    guide: Any = "proximal"
    span: Any = 0.03
    length: Any = 0.03
    axial_stiffness: float = 9000.0
    order: Any = None
    spring_stiffness: Any = 0.0
    spring_angle: Any = 0.0
    partner: Sequence[int] | None = None
    pin_elements: int = 2
    bend_elements: int = 8
    friction_error: float = 0.1
    compliance_error: float = 0.5
    angle_error: float = 0.0

    def __post_init__(self) -> None:
        R = _read_array("radii", self.radii, 2)
        tendons, joints = R.shape
        if not (1 <= joints <= MAX_JOINTS and 1 <= tendons <= MAX_TENDONS):
            raise RoutingError(
                f"radii: {tendons} tendons, {joints} joints; allowed are 1 to {MAX_TENDONS} "
                f"tendons and 1 to {MAX_JOINTS} joints"
            )
        set_field = object.__setattr__
        set_field(self, "radii", R)
        for name in ("friction", "wrap", "span", "length"):
            set_field(self, name, _read_table(name, getattr(self, name), R.shape))
        side = -np.sign(R) if self.side is None else _read_table("side", self.side, R.shape)
        set_field(self, "side", side)
        if self.side is not None and not np.isin(side, (-1.0, 0.0, 1.0)).all():
            raise RoutingError("side: allowed are -1, 0 and 1")
        if (self.span <= 0.0).any():
            raise RoutingError("span: must be positive, a stretch without length cannot stretch")
        for name in ("friction", "length"):
            if (getattr(self, name) < 0.0).any():
                raise RoutingError(f"{name}: must not be negative")
        for name in ("spring_stiffness", "spring_angle"):
            set_field(self, name, _read_table(name, getattr(self, name), (joints,)))
        if (self.spring_stiffness < 0.0).any():
            raise RoutingError("spring_stiffness: must not be negative")
        guide = np.broadcast_to(np.array(self.guide), R.shape)
        if not np.isin(guide, ("proximal", "distal", "spread")).all():
            raise RoutingError('guide: allowed are "proximal", "distal" and "spread"')
        set_field(self, "guide", guide)
        if not 0.0 < self.axial_stiffness < math.inf:
            raise RoutingError(f"axial_stiffness: {self.axial_stiffness} N, must be positive")
        if not 0.0 <= self.friction_error < 1.0:
            raise RoutingError(f"friction_error: {self.friction_error}, allowed are 0 to 1")
        for name in ("compliance_error", "angle_error"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise RoutingError(f"{name}: {getattr(self, name)}, must not be negative")
        if not (1 <= self.pin_elements <= 20 and 1 <= self.bend_elements <= 20):
            raise RoutingError("pin_elements, bend_elements: must be 1 to 20")
        partner = [-1] * joints if self.partner is None else list(self.partner)
        if len(partner) != joints or not all(-1 <= k < joints for k in partner):
            raise RoutingError(f"partner: give {joints} numbers from -1 to {joints - 1}")
        set_field(self, "partner", tuple(partner))
        set_field(self, "order", self._read_order())
        for tendon in range(tendons):
            K = float(np.sum(self.get_friction(np.zeros(joints))[tendon]))
            if K > MAX_K:
                raise RoutingError(f"friction: tendon {tendon} has K {K:.4g}, at most {MAX_K:g}")
        self._check_motion()

    @property
    def tendons(self) -> int:
        """Number of tendons."""
        return int(np.shape(self.radii)[0])

    @property
    def joints(self) -> int:
        """Number of joints."""
        return int(np.shape(self.radii)[1])

    def get_friction(self, angles: ArrayLike) -> Array:
        """Return K of each passed joint at joint `angles` [rad], shape (tendons, joints).

        K_sheath plus the sum over a row is the friction coordinate of the tendon's end.
        """
        theta = _read_table("angles", angles, (self.joints,))
        partner = np.array(self.partner)
        other = np.where(partner < 0, 0.0, theta[partner])
        bend = np.hypot(np.asarray(self.wrap) + np.asarray(self.side) * theta, other)
        K: Array = np.asarray(self.friction) * bend
        return K

    def find_pretension_pattern(self) -> Array:
        """Return tensions over the largest that balance at all joints without a spring.

        Shape (tendons,), all positive; the pattern whose smallest entry is largest.

        Raises
        ------
        RoutingError
            If there is none.
        """
        from scipy.optimize import linprog  # later: other processes need no optimiser

        free = np.asarray(self.spring_stiffness) == 0.0
        balance = np.asarray(self.radii)[:, free].T / np.abs(np.asarray(self.radii)).max()
        # largest m with m <= t_i <= 1 and balance t = 0
        n = self.tendons
        found = linprog(
            np.append(np.zeros(n), -1.0),
            A_ub=np.hstack([-np.eye(n), np.ones((n, 1))]),
            b_ub=np.zeros(n),
            A_eq=np.hstack([balance, np.zeros((len(balance), 1))]) if len(balance) else None,
            b_eq=np.zeros(len(balance)) if len(balance) else None,
            bounds=[(0.0, 1.0)] * (n + 1),
        )
        if not found.success or found.x[-1] < 1e-6:
            raise RoutingError(
                "radii: no positive tensions of all tendons balance each other: a joint lacks an "
                "antagonist; add a tendon or give the joint a spring_stiffness"
            )
        pattern: Array = found.x[:n]
        return pattern

    def _check_motion(self) -> None:
        R = np.asarray(self.radii)
        for joint in range(self.joints):
            if not R[:, joint].any():
                raise RoutingError(f"radii: no tendon moves joint {joint}, its column is zero")
        for tendon in range(self.tendons):
            if not R[tendon].any():
                raise RoutingError(f"radii: no joint moves tendon {tendon}, its row is zero")
        rank = int(np.linalg.matrix_rank(R, tol=RANK_TOLERANCE * np.abs(R).max()))
        if rank < self.joints:
            raise RoutingError(
                f"radii: {self.joints} joints, but the tendons can move only {rank} of them "
                "independently"
            )
        self.find_pretension_pattern()

    def _read_order(self) -> tuple[tuple[int, ...], ...]:
        touched = (np.asarray(self.radii) != 0.0) | (np.asarray(self.wrap) != 0.0)
        if self.order is None:
            return tuple(tuple(int(j) for j in np.flatnonzero(row)) for row in touched)
        if len(self.order) != self.tendons:
            raise RoutingError(f"order: {len(self.order)} rows, but there are {self.tendons}")
        for tendon, joints in enumerate(self.order):
            if len(set(joints)) < len(joints) or not set(joints) <= set(range(self.joints)):
                raise RoutingError(
                    f"order: tendon {tendon} passes {list(joints)}; allowed are the joints 0 to "
                    f"{self.joints - 1}, each once"
                )
            missing = set(np.flatnonzero(self.radii[tendon])) - set(joints)
            if missing:
                raise RoutingError(
                    f"order: tendon {tendon} has a radius at joint {min(missing)}, but does not "
                    "pass it"
                )
        return tuple(tuple(int(j) for j in joints) for joints in self.order)


class PreparedRouting(NamedTuple):
    """A routing as rows: of each tendon the sheath's end, then its friction elements in order.

    A row's tension is that behind its element, up to the next one.
    """

    first: NDArray[np.int64]  # row of the sheath's end of each tendon, and the number of rows
    joint: NDArray[np.int64]  # joint that turns the element
    partner: NDArray[np.int64]  # the other bend of its curved section, or -1
    friction: Array
    wrap: Array  # [rad]
    side: Array
    compliance: Array  # [m/N] of the stretch behind the element, contact with pins apart
    contact: Array  # [m/(N rad)] shape (rows, 2): by the bend of this element and of the next
    spread: Array  # [m/rad] half of what slips more at the near end of an element than at its far
    turned_by: NDArray[np.int64]  # the joints that shorten the stretch, at most two, (rows, 2)
    shortening: Array  # [m/rad] shape (rows, 2): by what turning these shortens it
    behind: NDArray[np.int64]  # row behind each passed joint, -1 elsewhere, (tendons, joints)
    friction_error: Array  # relative
    compliance_error: float
    angle_error: float  # [rad]


def prepare(
    routing: Routing, sheaths: Sequence[Sheath] | None = None, *, sheath_error: float = 0.02
) -> PreparedRouting:
    """Return what the steps of `routing` need.

    Parameters
    ----------
    sheaths : sequence of Sheath, optional
        Of each tendon. With them the steps take the tension at the housing: joint angles then also
        tell which way the tendon slides in its sheath. Without, they take that at the sheath's end.
    sheath_error : float
        Relative error of the sheaths' friction that intervals allow for.

    Raises
    ------
    RoutingError
        If there is not one sheath a tendon, or one has drag or asymmetry, which are not modelled.
    """
    if sheaths is not None and len(sheaths) != routing.tendons:
        raise RoutingError(f"sheaths: {len(sheaths)}, but there are {routing.tendons} tendons")
    if any(sheath.drag != 0.0 or sheath.asymmetry != 1.0 for sheath in sheaths or ()):
        raise RoutingError("sheaths: drag and asymmetry are not modelled with passed joints")
    partner: Sequence[int] = routing.partner or ()
    first: list[int] = [0]
    rows: list[_Row] = []
    errors: list[float] = []
    behind = np.full((routing.tendons, routing.joints), -1, dtype=np.int64)
    for tendon in range(routing.tendons):
        begin = len(rows)
        sheath = _lay_out_sheath(sheaths[tendon], routing.joints) if sheaths else []
        errors += [sheath_error] * len(sheath)
        rows += _lay_out_tendon(routing, tendon, sheath)
        errors += [routing.friction_error] * (len(rows) - len(errors))
        for index in range(begin + max(len(sheath), 1), len(rows)):
            behind[tendon, rows[index].joint] = index
        first.append(len(rows))
    shortening = np.array([row.shortening for row in rows])
    if routing.joints == 1:
        shortening = np.hstack([shortening, np.zeros_like(shortening)])
    turned_by = np.argsort(-np.abs(shortening), axis=1, kind="stable")[:, :2]
    return PreparedRouting(
        np.array(first),
        np.array([row.joint for row in rows]),
        np.array([partner[row.joint] if row.side else -1 for row in rows]),
        np.array([row.friction for row in rows]),
        np.array([row.wrap for row in rows]),
        np.array([row.side for row in rows]),
        np.array([row.length / (row.stiffness or routing.axial_stiffness) for row in rows]),
        np.array([row.contact for row in rows]) / routing.axial_stiffness,
        np.array([row.spread for row in rows]),
        np.minimum(turned_by, routing.joints - 1),
        np.take_along_axis(shortening, turned_by, axis=1),
        behind,
        np.array(errors),
        routing.compliance_error,
        routing.angle_error,
    )


class _Row(NamedTuple):
    joint: int
    friction: float
    wrap: float
    side: float
    length: float  # [m] of the stretch behind, contact with pins apart
    contact: tuple[float, float]  # [m/rad] of it, by the bend of this element and of the next
    spread: float  # [m/rad]
    shortening: Array
    stiffness: float = 0.0  # EA [N], 0: that of the routing


class _Element(NamedTuple):
    joint: int
    divisor: int  # number of elements at this joint
    place: float  # part of the joint's turning that happens before it
    length: float  # [m] before and behind it, each
    contact: float  # [m/rad] before and behind it, each
    spread: float  # [m/rad]
    span: float  # [m] behind


def _list_elements(routing: Routing, tendon: int) -> list[_Element]:
    elements = []
    for joint in routing.order[tendon]:
        kind, span, length, friction, R = (
            np.asarray(table)[tendon, joint]
            for table in (
                routing.guide, routing.span, routing.length, routing.friction, routing.radii
            )
        )  # fmt: skip
        is_spread = kind == "spread"
        n = 1 if friction == 0.0 else (routing.bend_elements if is_spread else routing.pin_elements)
        half, contact = (length / n / 2, 0.0) if is_spread else (0.0, abs(R) / n / 2)
        for i in range(n):
            place = (i + 0.5) / n if is_spread else float(kind == "distal")
            last = span if i == n - 1 else 0.0
            spread = abs(R) / n / 2 if is_spread else 0.0
            elements.append(_Element(joint, n, place, half, contact, spread, last))
    return elements


def _lay_out_sheath(sheath: Sheath, joints: int) -> list[_Row]:
    """Return the rows of a sheath from its housing, straight stretches without friction."""
    nothing = np.zeros(joints)
    rows = [_Row(0, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0), 0.0, nothing, sheath.axial_stiffness)]
    for section in sheath.sections:
        K = sheath.friction * section.bend_angle
        n = math.ceil(SHEATH_ELEMENTS * K / sheath.K) if K > 0.0 else 0
        half = section.length / max(n, 1) / 2
        for _ in range(n):
            rows[-1] = rows[-1]._replace(length=rows[-1].length + half)
            rows.append(_Row(0, K / n, 1.0, 0.0, half, (0.0, 0.0), 0.0, nothing,
                             sheath.axial_stiffness))  # fmt: skip
        if n == 0:
            rows[-1] = rows[-1]._replace(length=rows[-1].length + section.length)
    return rows


def _lay_out_tendon(routing: Routing, tendon: int, sheath: list[_Row]) -> list[_Row]:
    R, wrap = np.asarray(routing.radii)[tendon], np.asarray(routing.wrap)[tendon]
    friction, side = np.asarray(routing.friction)[tendon], np.asarray(routing.side)[tendon]
    elements = _list_elements(routing, tendon)
    # travel past each element per rad: what turns behind it, and its own joint's part behind it
    arms, turned = [R.copy()], set()
    for element in elements:
        turned.add(element.joint)
        arm = np.array([0.0 if j in turned else R[j] for j in range(len(R))])
        arm[element.joint] = (1.0 - element.place) * R[element.joint]
        arms.append(arm)
    arms.append(np.zeros_like(R))
    end = _Row(0, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0), 0.0, arms[0] - arms[1])
    if sheath:
        end = sheath[-1]._replace(shortening=end.shortening)
    rows = [*sheath[:-1], end]
    for index, element in enumerate(elements):
        follower = elements[index + 1] if index + 1 < len(elements) else None
        joint = element.joint
        rows.append(
            _Row(
                joint,
                float(friction[joint]) / element.divisor,
                float(wrap[joint]),
                float(side[joint]),
                element.length + element.span + (follower.length if follower else 0.0),
                (element.contact, follower.contact if follower else 0.0),
                element.spread,
                arms[index + 1] - arms[index + 2],
            )
        )
    return rows


def _read_array(name: str, values: ArrayLike, dimensions: int) -> Array:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RoutingError(f"{name}: not a table of numbers") from error
    if array.ndim != dimensions:
        raise RoutingError(f"{name}: {array.ndim} dimensions, must be {dimensions}")
    if not np.isfinite(array).all():
        raise RoutingError(f"{name}: must be finite")
    return array


def _read_table(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    array = _read_array(name, values, np.ndim(values))
    if array.shape not in ((), shape):
        raise RoutingError(f"{name}: shape {array.shape}, must be {shape} or one number")
    return np.broadcast_to(array, shape).copy()
