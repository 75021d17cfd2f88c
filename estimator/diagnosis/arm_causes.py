"""What may be wrong with an arm: numbers that are not as its config has them.

The friction or the radius of a joint changes all tendons that pass it, an entry of the routing
those of a row, the fault of a sensor one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.arm_model import ArmData, TendonValues, group_rows
from estimator.routing.routing import Routing

NONE_SHARE = 0.1  # of a radius that the config has

Change = Callable[[TendonValues, float], TendonValues]


@dataclass(frozen=True, eq=False)
class ArmCause:
    """One number that may be wrong."""

    kind: str  # as in reports: passed_joint_friction, joint_radius, coupling, or of one tendon
    joint: int  # from 0; -1 for a fault of a tendon alone
    tendons: tuple[int, ...]  # rows of the routing that it changes
    change: Change  # returns the values of one of these, with the number
    unit: str  # of the number; "" for a share
    step: float  # a change that matters


_TENSION_FAULTS = (("gain", "", 0.02), ("bias", "N", 0.1))
"""Field of `TendonValues`, unit and step of what may be wrong with a load cell."""


def list_arm_causes(data: ArmData, routing: Routing) -> list[ArmCause]:
    """Return what may be wrong with an arm, as far as its data can tell."""
    R = np.asarray(routing.radii)
    has_travel = data.proximal_displacement is not None
    tendons, joints = R.shape
    causes = []
    rows = group_rows(routing)
    for j in range(joints):
        passing = np.flatnonzero(np.asarray(routing.friction)[:, j])
        if data.distal_tension is not None and data.is_at_anchor and len(passing):
            causes.append(
                _build_cause("passed_joint_friction", j, passing, _add_friction, "", 0.02)
            )
        if not (has_travel and data.has_encoders):
            continue
        of_joint = [row for row in rows if R[row[0], j] != 0.0]
        causes.append(
            _build_cause("joint_radius", j, np.flatnonzero(R[:, j]), _scale_radius, "", 0.02)
        )
        for row in rows:
            if [row] != of_joint:
                causes.append(_build_cause("coupling", j, row, _shift_entry, "m", 1e-4))
            if len(row) > 1:
                causes += [
                    _build_cause("tendon_radius", j, [i], _shift_entry, "m", 1e-4)
                    for i in row
                    if R[i, j] != 0.0
                ]
    faults = [(f"proximal_tension_{fault[0]}", *fault) for fault in _TENSION_FAULTS]
    if data.distal_tension is not None:
        faults += [
            (f"distal_tension_{name}", f"distal_{name}", unit, step)
            for name, unit, step in _TENSION_FAULTS
        ]
    if has_travel:
        faults += [
            ("encoder_scale", "encoder_scale", "", 0.005),
            ("encoder_play", "play", "m", 2e-5),
        ]
    causes += [
        _build_cause(kind, -1, [i], _set(field), unit, step)
        for i in range(tendons)
        for kind, field, unit, step in faults
    ]
    return causes


def _build_cause(
    kind: str,
    joint: int,
    tendons: Sequence[int] | NDArray[np.intp],
    change: Callable[[TendonValues, float, int], TendonValues],
    unit: str,
    step: float,
) -> ArmCause:
    def apply(values: TendonValues, number: float) -> TendonValues:
        return change(values, number, joint)

    return ArmCause(kind, joint, tuple(int(i) for i in tendons), apply, unit, step)


def _set(name: str) -> Callable[[TendonValues, float, int], TendonValues]:
    return lambda values, number, _: TendonValues(**values._asdict() | {name: number})


def _replace_entry(table: Array, joint: int, value: float) -> Array:
    table = table.copy()
    table[joint] = value
    return table


def _add_friction(values: TendonValues, number: float, joint: int) -> TendonValues:
    mu = max(values.friction[joint] + number, 0.0)
    return values._replace(friction=_replace_entry(values.friction, joint, mu))


def _scale_radius(values: TendonValues, number: float, joint: int) -> TendonValues:
    radius = (1.0 + number) * values.radii[joint]
    return values._replace(radii=_replace_entry(values.radii, joint, radius))


def _shift_entry(values: TendonValues, number: float, joint: int) -> TendonValues:
    """Change the radius of a row's first tendon by a number, of the others as they are wound.

    What is left of next to none is none: then the tendon does not touch the guide either.
    """
    radius = values.radii[joint] + values.winding * number
    friction = values.friction
    if abs(radius) < NONE_SHARE * abs(values.radii[joint]):
        friction = _replace_entry(friction, joint, 0.0)
    return values._replace(radii=_replace_entry(values.radii, joint, radius), friction=friction)
