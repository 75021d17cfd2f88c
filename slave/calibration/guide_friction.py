"""Friction at joints that tendons of others pass, from drags in several postures.

In a drag both tendons of a joint slide along sheaths and guides, so that, with (T20) and (T22),

    S = K_a + K_b + sum_j mu_j (phi_a,j(theta) + phi_b,j(theta)) +- g,

where g is the relative difference of the load cells' gains, of opposite sign in opposite drags. The
postures set the bends phi apart from the sheaths; mu_j is one for all tendons that pass joint j.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.calibration.calibration import CalibrationError
from estimator.calibration.drag import fit_friction_sum
from estimator.fitting import COVERAGE_FACTOR, MeasuredValue
from estimator.routing.routing import Routing, prepare
from slave.arm_estimate import build_routing
from slave.calibration.calibration_file import GuideFriction, ValueWithUncertainty
from slave.calibration.procedure_log import ProcedureData
from slave.calibration.procedure_state import Phase
from slave.calibration.tendon_identification import (
    RELATIVE_ERROR_MIN,
    ArmStretches,
    PulledTendon,
    round_significant,
)
from teleop.config.arm import ArmConfig, assemble_lengths, assemble_tendon_rows

ANGLE_ERROR = 0.04  # [rad] standard uncertainty of a joint in a posture
UNIT_FRICTION = 1e-3  # small: a routing bounds K
SECTION_ELEMENTS = 8  # of friction along a curved section
FRICTION_START = 0.1  # of guides, for the uncertainty of their bends
MISFIT_MAX = 4.0  # of the reduced chi square: beyond it one mu a joint does not describe the drags

Bends = Callable[[Array], Array]


class PosturedDrag(NamedTuple):
    """A drag of one joint while the joints that its tendons pass are held."""

    joint: int  # from 0
    side: int  # of the tendon that is pulled
    total: MeasuredValue  # S
    bend: Array  # [rad] of both tendons together at each joint, shape (joints,)


class GuideFit(NamedTuple):
    """What the drags of all postures say."""

    sums: dict[int, MeasuredValue]  # K_a + K_b of the sheaths of each joint that passes others
    friction: dict[int, MeasuredValue]  # mu at each passed joint
    remark: str = ""


NO_GUIDES = GuideFit({}, {})


def build_bends(joints: Sequence[Sequence[int]], arms: Sequence[ArmConfig]) -> Bends:
    """Return the function from travels [m] of all joints to bends [rad], shape (joints, joints).

    Row k is of both tendons of joint k together, column j at the guide of joint j.
    """
    routing = build_routing(joints, [replace(arm, friction=UNIT_FRICTION) for arm in arms])
    radius = assemble_tendon_rows(arms, joints).radius

    def compute_bends(travel: Array) -> Array:
        K = routing.get_friction(travel / radius)
        return np.array([K[list(tendons)].sum(axis=0) for tendons in joints]) / UNIT_FRICTION

    return compute_bends


def list_arm_stretches(
    record: ProcedureData, arms: Sequence[ArmConfig]
) -> dict[tuple[int, int], ArmStretches]:
    """Return what follows the sheath of each tendon while it is pulled, by joint and side."""
    if not arms:
        return {}
    rows = assemble_tendon_rows(arms, record.joints)
    in_arms = assemble_lengths(arms, rows.travel).sum(axis=1)
    routing = replace(
        build_routing(record.joints, arms), bend_elements=SECTION_ELEMENTS, axial_stiffness=1.0
    )
    found = {}
    for k, tendons in enumerate(record.joints):
        for side, tendon in enumerate(tendons):
            pulled = PulledTendon(record, k, side).select_rows(Phase.PULL, Phase.RELEASE)
            if in_arms[tendon] > 0.0 and pulled.any():
                travel = np.asarray(record.joint_travel[pulled].mean(axis=0))
                found[k, side] = _locate_stretches(
                    routing, tendon, float(in_arms[tendon]), rows.radius, travel
                )
    return found


def _locate_stretches(
    routing: Routing, tendon: int, total: float, radius: Array, travel: Array
) -> ArmStretches:
    """Return the stretches of a tendon with the joints at their stops, at `travel` [m].

    `total` [m] is their length without contact with pins; the routing leaves out the first one.

    A stop that yields by x per newton lets joint j go by x sum_e s_ej T_e, where it shortens
    stretch e by s_ej of its travel, and all stretches together by their sum.
    """
    prepared = prepare(routing)
    part = slice(prepared.first[tendon], prepared.first[tendon + 1])
    joint, partner, turned_by = (
        table[part] for table in (prepared.joint, prepared.partner, prepared.turned_by)
    )
    theta = travel / radius
    bend = np.abs(prepared.wrap[part] + prepared.side[part] * theta[joint])
    bend = np.hypot(bend, theta[partner] * (partner >= 0))
    contact, length = prepared.contact[part], prepared.compliance[part].copy()  # EA is 1
    length[0] = max(total - length.sum(), 0.0) + contact[1, 0] * bend[1]
    length[1:] += contact[1:, 0] * bend[1:]
    length[1:-1] += contact[1:-1, 1] * bend[2:]
    all_of_it = (np.asarray(routing.radii)[tendon] / radius**2)[turned_by]
    return ArmStretches(
        tuple(length.tolist()),
        tuple(np.cumsum(prepared.friction[part] * bend).tolist()),
        tuple((all_of_it * prepared.shortening[part]).sum(axis=1).tolist()),
        routing.friction_error / COVERAGE_FACTOR,
    )


def identify_guide_friction(record: ProcedureData, bends: Bends, gain_error: float) -> GuideFit:
    """Return the friction at passed joints, by the drags in the record of a procedure."""
    drags: list[PosturedDrag] = []
    remarks: list[str] = []
    passes_others = bends(np.full(len(record.joints), 1e-3)).any(axis=1)
    for stage in np.unique(record.stage):
        rows = record.stage == stage
        for m in np.flatnonzero((record.phase[rows] == Phase.DRAG).any(axis=0) & passes_others):
            dragged = rows & (record.phase[:, m] == Phase.DRAG)
            bend = bends(np.asarray(record.joint_travel[dragged].mean(axis=0)))[m]
            side = int(record.side[dragged, m][0]) - 2
            pulled, drawn = (record.joints[m][k] for k in (side, 1 - side))
            tension = record.tension[dragged]
            stretch = record.stops[m][side].compliance * tension[:, pulled]
            try:
                total = fit_friction_sum(
                    tension[:, pulled], tension[:, drawn], record.travel[dragged, pulled] - stretch
                )
            except CalibrationError as error:
                remarks.append(f"joint {m + 1}: a drag is not used: {error}")
                continue
            drags.append(PosturedDrag(int(m), side, total, bend))
    fit = fit_guide_friction(drags, gain_error) if drags else NO_GUIDES
    return fit._replace(remark="; ".join(filter(None, [*remarks, fit.remark])))


def fit_guide_friction(drags: Sequence[PosturedDrag], gain_error: float) -> GuideFit:
    """Return the sums of the sheaths' K and mu of passed joints by weighted least squares.

    What the postures do not tell apart is left out. Standard uncertainties hold noise, the gains,
    the angles of the postures, and the misfit.
    """
    movers = sorted({drag.joint for drag in drags})
    bend = np.array([drag.bend for drag in drags])
    passed = [int(j) for j in np.flatnonzero(bend.any(axis=0))]
    by_mover = np.array([[float(drag.joint == m) for m in movers] for drag in drags])
    signs = np.array([1.0 - 2.0 * drag.side for drag in drags])[:, None]
    columns = np.hstack([by_mover, bend[:, passed], signs * by_mover])
    prior = np.zeros((len(movers), columns.shape[1]))
    prior[:, -len(movers) :] = np.eye(len(movers))
    gains = np.full(len(movers), max(np.sqrt(2.0) * gain_error, 1e-6))
    angles = 2.0 * ANGLE_ERROR * FRICTION_START * (bend > 0.0).sum(axis=1) ** 0.5
    noise = np.hypot([drag.total.uncertainty for drag in drags], angles)
    weights = 1.0 / np.append(noise, gains)
    matrix = np.vstack([columns, prior]) * weights[:, None]
    right = np.append([drag.total.value for drag in drags], np.zeros(len(movers))) * weights
    values, _, rank, _ = np.linalg.lstsq(matrix, right)
    freedom = len(drags) - len(movers) - len(passed)
    if rank < columns.shape[1] or freedom < 0:
        return GuideFit({}, {}, "friction of passed joints not found: too few postures")
    residual = right - matrix @ values
    misfit = float(residual @ residual) / max(freedom, 1)
    sigma = np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)) * max(misfit, 1.0))
    found = [MeasuredValue(float(v), float(s)) for v, s in zip(values, sigma, strict=True)]
    remark = ""
    if misfit > MISFIT_MAX:
        remark = "the drags of different postures disagree: friction of passed joints may differ "
        remark += "between tendons, or arms.wrap is wrong"
    return GuideFit(
        dict(zip(movers, found, strict=False)),
        dict(zip(passed, found[len(movers) :], strict=False)),
        remark,
    )


def build_guide_entries(fit: GuideFit) -> tuple[GuideFriction, ...]:
    """Return the entries of the calibration file."""
    return tuple(
        GuideFriction(
            j + 1,
            ValueWithUncertainty(round_significant(mu.value), round_significant(mu.uncertainty)),
            round_significant(
                min(max(COVERAGE_FACTOR * mu.uncertainty / mu.value, RELATIVE_ERROR_MIN), 0.99)
            ),
        )
        for j, mu in sorted(fit.friction.items())
        if mu.value > 0.0
    )
