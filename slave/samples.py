"""Samples of the rig as rows of records, and the estimates of every tendon from them."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.online import online
from estimator.online.tendon_estimate import INVALID_INPUT
from estimator.structs import StructArray
from slave import control
from slave.adaptation import TendonAdapter, adapt_tendons
from slave.arm_estimate import ArmEstimator, add_arm_stretch, estimate_arm_forces
from slave.loop_records import EstimatedSample, SlaveMemory
from slave.rig import RigSample
from slave.rig_layout import EstimatedTendon, RigLayout
from teleop.messages.messages import MAX_TENDONS


def fill_sample(rows: StructArray, index: int, sample: RigSample) -> None:
    """Write a sample of the rig into a row for `tick`.

    Missing entries are NaN, which the estimator rejects.
    """
    values = (
        *(sample.proximal_tension, sample.proximal_displacement),
        *(sample.bench_distal_tension, sample.bench_distal_displacement),
        *(sample.loop_moved_tension, sample.loop_held_tension),
    )
    channels = _MISSING.copy()
    for k, channel in enumerate(values):
        if channel is not None:
            channels[k, : len(channel)] = channel[:MAX_TENDONS]
    has_displacement = sample.proximal_displacement is not None
    _fill_row(rows, index, float(sample.time_s), has_displacement, channels)


# Copied to one array type, whatever the rig returns: numba would compile again for any other type,
# in the middle of a session.
_MISSING = np.full((6, MAX_TENDONS), math.nan)


@jit_compile
def _fill_row(
    rows: StructArray, index: int, time_s: float, has_displacement: bool, channels: Array
) -> None:
    row = rows[index]
    row.time_s, row.has_displacement = time_s, has_displacement
    for i in range(MAX_TENDONS):
        row.tendons[i].tension, row.tendons[i].displacement = channels[0, i], channels[1, i]
        row.bench_tension[i], row.bench_displacement[i] = channels[2, i], channels[3, i]
        row.loop_tension[i, 0], row.loop_tension[i, 1] = channels[4, i], channels[5, i]


def to_sample_rows(samples: Sequence[RigSample]) -> StructArray:
    """Return samples as rows for `tick`, shape (samples,); see `fill_sample`."""
    rows = EstimatedSample.array(len(samples))
    for k, sample in enumerate(samples):
        fill_sample(rows, k, sample)
    return rows


@jit_compile
def estimate(
    layouts: StructArray,
    prepared: StructArray,
    estimators: StructArray,
    memories: StructArray,
    with_dynamics: bool | None,
    arm: ArmEstimator | None,
    adapter: TendonAdapter | None,
    rows: StructArray,
    sample_count: int,
    extension_estimates: Array | None = None,
) -> None:
    """Step each tendon's estimator with the first `sample_count` rows; fill in their estimates.

    `with_dynamics` is None where no model has dynamic effects; see `online.advance`. `arm` is None
    where no joints share tendons, `adapter` where K stays as calibrated.
    `extension_estimates`, shape (sample_count, 4, tendons), are tension at the tip, its interval
    [N] and elongation [m] by the estimator of an extension; NaN where it has none.
    """
    layout, memory = layouts[0], memories[0]
    for s in range(sample_count):
        row = rows[s]
        row.elapsed = row.time_s - memory.sample_time if memory.has_sample else 0.0
        memory.sample_time = row.time_s
        memory.has_sample = True
        for i in range(layout.tendons):
            tendon = row.tendons[i]
            tendon.corrected_tension, tendon.corrected_displacement = online.advance(
                prepared[i],
                estimators[i],
                tendon.tension,
                tendon.displacement,
                row.elapsed,
                tendon.estimate,
                with_dynamics,
            )
            if extension_estimates is not None and math.isfinite(extension_estimates[s, 0, i]):
                _replace_estimate(tendon, extension_estimates[s, :, i])
        if adapter is not None:
            adapt_tendons(
                adapter,
                layout,
                prepared,
                estimators,
                row.tendons,
                row.loop_tension[:],
                row.elapsed,
            )
        if arm is not None:
            add_arm_stretch(arm, row.tendons)
        _end_sample(layout, memory, row)
        if arm is not None and memory.has_offsets:
            control.estimate_joints(
                layout, row.tendons, memory.offsets, memory.arm_force, memory.joints
            )
            estimate_arm_forces(
                arm,
                layout,
                prepared,
                estimators,
                row.tendons,
                row.elapsed,
                memory.joints,
                memory.arm_force,
            )


@jit_compile
def _replace_estimate(tendon: EstimatedTendon, values: Array) -> None:
    """Replace the tension at the tip, its interval [N] and the elongation [m] by `values`."""
    tip = tendon.estimate
    tip.distal_tension, tip.low, tip.high = values[0], values[1], values[2]
    tip.adapted_low = tip.adapted_high = values[0]
    tip.elongation = values[3]
    tip.distal_displacement = tendon.corrected_displacement - tip.elongation


@jit_compile
def _end_sample(layout: RigLayout, memory: SlaveMemory, row: EstimatedSample) -> None:
    usable = True
    newest: Any = memory.tendons
    for i in range(layout.tendons):
        tendon = row.tendons[i]
        tendon.valid = tendon.estimate.status & INVALID_INPUT == 0
        usable = usable and tendon.valid
        newest[i] = tendon
    if usable and not memory.has_offsets:
        memory.has_offsets = control.compute_offsets(layout, row.tendons, memory.offsets)
