"""What the online estimator remembers of one tendon, as a record."""

from collections.abc import Sequence
from typing import Annotated

from estimator.array_types import Array
from estimator.law.play_profile import PROFILE_SIZE, build_pretensioned_profile
from estimator.law.tables import TABLES_SIZE, build_tables
from estimator.online import dynamic_correction
from estimator.online.dynamic_correction import DynamicConstants, DynamicState
from estimator.online.reading_correction import MAX_CORRECTIONS, Corrections, build_corrections
from estimator.online.tendon_model import TendonModel
from estimator.structs import F64, Field, Flag, Struct, StructArray, view_struct

# --- a tendon model made ready for the compiled estimator, as a record

TENSION_FLOOR = 1e-3
"""Least noise [N] the decisions reckon with, however good the load cell is said to be."""

DISPLACEMENT_FLOOR = 2e-7
"""Least noise [m] the decisions reckon with: an encoder has counts."""

BOUND_SIGMAS = 4.0
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
    K_below: F64 = 0.0  # by which K may be smaller, in addition: estimator.adaptation
    K_above: F64 = 0.0  # by which it may be larger
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


INF = float("inf")
NAN = float("nan")


class EstimatorState(Struct):
    """One tendon between two samples."""

    started: Flag = False  # a sample has been taken
    has_displacement: Flag = False  # so had the previous sample, and increments mean something
    tip_drives: Flag = False  # the tip drives the profile, not the motor

    mean_tension: F64 = 0.0  # [N] averaged
    tension_variance: F64 = 0.0  # [N^2] of the averaged tension
    mean_displacement: F64 = 0.0  # [m] averaged with the same lag
    held_tension: F64 = 0.0  # [N] treated: averaged, then a dead band; it drives the profile
    tension_direction: F64 = 0.0  # sign of its last change
    min_tension: F64 = INF  # [N] extremes of the treated tension since the start
    max_tension: F64 = 0.0  # [N]
    held_displacement: F64 = 0.0  # [m] behind a dead band, which tells where the motor turned
    displacement_direction: F64 = 0.0  # sign of its last change

    # the window of evidence about the driving end (estimator.online.driving_end): where it began
    anchor_tension: F64 = 0.0  # [N]
    anchor_displacement: F64 = 0.0  # [m]
    anchor_elongation: F64 = 0.0  # [m] of the profile there
    anchor_age: F64 = 0.0  # [s]

    # the window of proof of the interval (interval): where it began, and its extremes
    window_tension: F64 = 0.0  # [N]
    window_displacement: F64 = 0.0  # [m]
    window_age: F64 = 0.0  # [s]
    window_min: F64 = 0.0  # [N]
    window_max: F64 = 0.0  # [N]

    proved_low: F64 = 0.0  # [N] T_out as proved by motion and aged since
    proved_high: F64 = INF  # [N]
    low: F64 = 0.0  # [N] the interval last reported, of the law
    high: F64 = INF  # [N]

    profile: Annotated[Array, Field("f8", PROFILE_SIZE)]  # estimator.law.play_profile
    anchor_profile: Annotated[Array, Field("f8", PROFILE_SIZE)]  # at the anchor
    dynamics: DynamicState
    remembered: Annotated[Array, Field("f8", MAX_CORRECTIONS, fill=NAN)]  # by each correction


def build_initial_state(prepared: PreparedTendon) -> EstimatorState:
    """Return the state before the first sample."""
    state = EstimatorState.new()
    state.profile[:] = build_pretensioned_profile(prepared.tables, float(prepared.pretension))
    state.anchor_profile[:] = state.profile
    if prepared.has_dynamics:
        dynamic_correction.reset(prepared.dynamics, state.dynamics)
    return state


def build_initial_states(prepared: StructArray) -> StructArray:
    """Return the states of the tendons of a rig before the first sample, shape (n,)."""
    states = EstimatorState.array(len(prepared))
    for i in range(len(prepared)):
        states[i] = build_initial_state(view_struct(prepared, i))
    return states
