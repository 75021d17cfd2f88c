"""The force at the tip that a loop would estimate with a model, and how far off it is.

The numbers are those of `teleop estimate` and `teleop run --replay` with the model's file: the same
estimator (estimator.online), the same noise, the same spikes excluded, and the same comparison with
what the load cell at the tip reads (estimator.online.score).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator import signals
from estimator.array_types import Array
from estimator.diagnosis.dataset import Model
from estimator.diagnosis.settings import SETTINGS
from estimator.measured_data import MeasuredData, Samples
from estimator.online.estimator import Estimator
from estimator.online.extension import build_extended_model
from estimator.online.score import Score
from estimator.online.tendon_model import TendonModel
from estimator.spikes import remove_spikes

SHEATH_LENGTH = 1.0  # [m] of the sheath: elongation and force go by L/EA


class ForceError(NamedTuple):
    """How far the estimated force is off what the load cell at the tip reads."""

    rmse: float  # [N]
    mean: float  # [N]
    largest: float  # [N]
    full_scale: float  # [N] largest reading
    samples: int
    spikes: int  # single-sample spikes of that cell, excluded


class FileForce(NamedTuple):
    """The force in one record, estimated with both models."""

    validation: bool  # not fitted
    before: ForceError
    after: ForceError


class RivalForce(NamedTuple):
    """What another cause in the model would do to the estimated force."""

    replaces: str
    label: str
    mean: float  # [N] mean of the absolute difference
    largest: float  # [N]
    full_scale: float  # [N] largest force estimated with the cause itself


def build_tendon_model(model: Model, duration: float, data: MeasuredData) -> TendonModel:
    """Return the estimator's model of a diagnosis's, with the noise of a record.

    Parameters
    ----------
    model : Model
    duration : float
        Of the longest fitted record [s]; friction is taken as at its end.
    data : MeasuredData
        The record.
    """
    stiffness = SHEATH_LENGTH / SETTINGS.assumed_compliance
    extended = build_extended_model(model.shared, model.effects, duration, SHEATH_LENGTH, stiffness)
    travel = data.proximal_displacement
    return TendonModel(
        extended.sheath,
        tension_noise=signals.noise_sigma(data.proximal_tension),
        displacement_noise=0.0 if travel is None else signals.noise_sigma(travel),
        extension=extended.extension,
        tip_effects=extended.tip_effects,
    )


def estimate_force(model: Model, duration: float, data: MeasuredData) -> Array:
    """Return the estimated force [N] of rows that have all that it is estimated from."""
    data = _select_complete_rows(data)
    return Estimator(build_tendon_model(model, duration, data)).run(remove_spikes(data)).tension


def compute_force_error(model: Model, duration: float, data: MeasuredData) -> ForceError | None:
    """Return how far the estimated force is off in a record; None without a cell at the tip."""
    data = _select_complete_rows(data)
    clean = remove_spikes(data)
    reading = clean.distal_tension
    if reading is None or data.distal_tension is None:
        return None
    tendon_model = build_tendon_model(model, duration, data)
    estimates = Estimator(tendon_model).run(clean)
    score = Score([tendon_model])
    score.add_columns(estimates.distal_tension, estimates.low, estimates.high, reading)
    summary = score.summary()
    if summary is None:
        return None
    return ForceError(
        summary["rmse_N"],
        summary["mean_N"],
        summary["max_N"],
        summary["full_scale_N"],
        summary["samples"],
        int(np.isnan(reading).sum() - np.isnan(data.distal_tension).sum()),
    )


def _select_complete_rows(data: MeasuredData) -> Samples:
    """Return the rows of a record in which nothing is missing that the force is estimated from."""
    travel, tip = data.proximal_displacement, data.distal_tension
    rows = np.isfinite(data.proximal_tension)
    if travel is not None:
        rows &= np.isfinite(travel)
        travel = travel[rows]
    tip = None if tip is None else np.where(np.isfinite(tip), tip, np.nan)[rows]
    return Samples(data.time[rows], data.proximal_tension[rows], travel, tip)


def compute_file_force(
    base_model: Model, model: Model, duration: float, data: MeasuredData, *, validation: bool
) -> FileForce | None:
    """Return the errors of the force in a record; None without a cell at the tip."""
    before, after = (
        compute_force_error(trial_model, duration, data) for trial_model in (base_model, model)
    )
    return None if before is None or after is None else FileForce(validation, before, after)


def compute_rival_force(
    model: Model,
    rival: Model,
    names: tuple[str, str],
    duration: float,
    records: Sequence[MeasuredData],
) -> RivalForce:
    """Return what a rival would do to the force; `names` are the cause it replaces and its own."""
    forces = [estimate_force(model, duration, data) for data in records]
    rival_forces = [estimate_force(rival, duration, data) for data in records]
    change = np.abs(np.concatenate(rival_forces) - np.concatenate(forces))
    full_scale = max(float(force.max()) for force in forces)
    return RivalForce(*names, float(change.mean()), float(change.max()), full_scale)
