"""A tendon model made ready for the compiled estimator, as a record."""

from collections.abc import Sequence
from typing import Annotated

from estimator.array_types import Array
from estimator.law.tables import TABLES_SIZE, build_tables
from estimator.online.dynamic_correction import DynamicConstants
from estimator.online.reading_correction import Corrections, build_corrections
from estimator.online.tendon_model import TendonModel
from estimator.records import F64, Field, Flag, Struct, StructArray

TENSION_FLOOR = 1e-3
"""Least noise [N] the decisions reckon with, however good the load cell is said to be."""

DISPLACEMENT_FLOOR = 2e-7
"""Least noise [m] the decisions reckon with: an encoder has counts."""

BOUND = 4.0
"""Sigma that bound a single reading."""


class PreparedTendon(Struct):
    """One tendon, as the estimator's compiled functions know it; see `TendonModel`."""

    tables: Annotated[Array, Field("f8", TABLES_SIZE)]  # estimator.law.tables, padded
    pretension: F64 = 0.0  # [N] all along the tendon at the start
    tension_noise: F64 = 0.0  # [N] standard deviation
    displacement_noise: F64 = DISPLACEMENT_FLOOR  # [m] standard deviation, not below the floor
    time_constant: F64 = 0.0  # [s] of the average that treats the tension
    dead_band: F64 = 0.0  # [-] that follows, in sigma of the averaged tension
    friction_error: F64 = 0.0  # relative, of K
    elongation_error: F64 = 0.0  # relative, of the predicted elongation
    tip_tension_rate: F64 = 0.0  # [N/s] at which T_out may change unseen
    has_dynamics: Flag = False  # whether `dynamics` are of any effect
    dynamics: DynamicConstants
    corrections: Corrections


def prepare(model: TendonModel) -> PreparedTendon:
    """Return the record of `model` for `online.advance`, `online.step` and `online.run`."""
    prepared = PreparedTendon.new(
        pretension=0.0 if model.initial == "slack" else float(model.initial),
        tension_noise=model.tension_noise,
        displacement_noise=max(model.displacement_noise, DISPLACEMENT_FLOOR),
        time_constant=model.treatment.time_constant if model.tension_noise > 0.0 else 0.0,
        dead_band=model.treatment.dead_band,
        friction_error=model.friction_error,
        elongation_error=model.elongation_error,
        tip_tension_rate=model.tip_tension_rate,
    )
    table = build_tables(model.sheath)
    prepared.tables[: len(table)] = table
    if model.extension is not None:
        prepared.corrections = build_corrections(model.extension.readings)
        if model.extension.dynamics is not None:
            prepared.has_dynamics = True
            prepared.dynamics = model.extension.dynamics
    return prepared


def prepare_all(models: Sequence[TendonModel]) -> StructArray:
    """Return the records of the tendons of a rig, shape (n,); see `prepare`."""
    prepared = PreparedTendon.array(len(models))
    for i, model in enumerate(models):
        prepared[i] = prepare(model)
    return prepared
