"""Degraded mode: a session that goes on after the monitor has demanded a calibration.

A calibration needs free tips, which there are none of inside a patient. With `on_demand: degrade` a
demand limits the session instead of ending it: the interval of each force is widened by the largest
error found since, at most `degraded_force` of a force is rendered, and no tip is commanded faster
than `degraded_speed`. It ends with a calibration (which starts the slave anew), or when of every
doubted tendon the transitions agree that its shape is as calibrated, or the adaptation has found
its K. A tendon with too few transitions, or with contradicting ones, stays doubted.
"""

from collections.abc import Sequence
from math import inf
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.structs import F64, Field, Flag, Struct
from slave.calibration import monitor
from slave.calibration.monitor import Advice, MonitorConfig, TendonMonitor
from slave.control.joint_estimate import JointEstimates
from slave.rig_layout import EstimatedTendons, RigLayout
from teleop.messages.messages import MAX_TENDONS

RAMP_S = 0.5  # [s] in which the limits come and go, so that force and motion have no step


class Degradation(Struct):
    """How far force and motion are limited."""

    active: Flag = False  # a calibration is due
    ramp: F64 = 0.0  # 0 = not limited, 1 = limited as configured
    doubted: Annotated[NDArray[np.int64], Field("i8", MAX_TENDONS)]  # 1 of doubted tendons
    # of each T_out over its estimate, or the inverse: the largest found
    ratio: Annotated[Array, Field("f8", MAX_TENDONS, fill=1.0)]


@jit_compile
def update_degradation(
    config: MonitorConfig,
    mode: Degradation,
    monitors: Sequence[TendonMonitor],
    advice: int,
    decided: NDArray[np.bool_],
) -> None:
    """Begin or end the mode by what the monitors say; not time-critical.

    `decided`, shape (tendons,), tells whose K the adaptation has found.
    """
    mode.active = mode.active or advice == Advice.DEMANDED
    if not mode.active:
        return
    is_doubted = False
    for i in range(len(decided)):
        ratio = max(1.0 + monitors[i].force_error, 1.0 / (1.0 + monitors[i].force_error))
        mode.ratio[i] = max(mode.ratio[i], ratio)
        if decided[i] or monitor.is_as_calibrated(config, monitors[i]):
            mode.doubted[i] = 0  # also if the interval of K is wide again a moment later
        elif ratio > 1.0 + config.advise:
            mode.doubted[i] = 1
        is_doubted = is_doubted or mode.doubted[i] > 0
    mode.active = is_doubted


@jit_compile
def advance_ramp(mode: Degradation, dt: float) -> None:
    """Let the limits come or go for a tick of `dt` [s]."""
    change = dt / RAMP_S if mode.active else -dt / RAMP_S
    mode.ramp = min(max(mode.ramp + change, 0.0), 1.0)
    if mode.ramp == 0.0 and not mode.active:
        mode.ratio[:] = 1.0


@jit_compile
def compute_force_reduction(config: MonitorConfig, mode: Degradation) -> float:
    """Return the part of the forces that is not rendered."""
    return mode.ramp * (1.0 - config.degraded_force)


@jit_compile
def compute_speed_max(config: MonitorConfig, mode: Degradation) -> float:
    """Return the largest speed of a tip [m/s]; infinite if not limited."""
    return config.degraded_speed / mode.ramp if mode.ramp > 0.0 else inf


@jit_compile
def widen_intervals(
    layout: RigLayout, mode: Degradation, tendons: EstimatedTendons, joint_estimates: JointEstimates
) -> None:
    """Widen the intervals of the joints' forces by the errors found, in place.

    A tendon's tension is within its interval times and divided by its ratio; a joint's force is
    wrong by at most the sum over the tendons that pass it.
    """
    if mode.ramp == 0.0:
        return
    for i in range(layout.tendons):
        if mode.ratio[i] == 1.0:  # its interval may be infinite
            continue
        error = mode.ramp * (mode.ratio[i] - 1.0) * tendons[i].estimate.high
        for j in range(layout.joints):
            if layout.travel[i, j] != 0.0:  # the error may be infinite, and is of no other joint
                joint_estimates[j].low -= abs(layout.travel[i, j]) * error
                joint_estimates[j].high += abs(layout.travel[i, j]) * error
