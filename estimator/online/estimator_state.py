"""What the online estimator remembers of one tendon, as a record."""

from typing import Annotated

from estimator.array_types import Array
from estimator.law.profile import PROFILE_SIZE, build_pretensioned_profile
from estimator.online import dynamic_correction
from estimator.online.dynamic_correction import DynamicState
from estimator.online.prepared_tendon import PreparedTendon
from estimator.online.reading_correction import MAX_CORRECTIONS
from estimator.records import F64, Field, Flag, Struct, StructArray, view_struct

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
    least_tension: F64 = INF  # [N] extremes of the treated tension since the start
    most_tension: F64 = 0.0  # [N]
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
    window_least: F64 = 0.0  # [N]
    window_most: F64 = 0.0  # [N]

    proved_low: F64 = 0.0  # [N] T_out as proved by motion and aged since
    proved_high: F64 = INF  # [N]
    low: F64 = 0.0  # [N] the interval last reported, of the law
    high: F64 = INF  # [N]

    profile: Annotated[Array, Field("f8", PROFILE_SIZE)]  # estimator.law.profile
    anchor_profile: Annotated[Array, Field("f8", PROFILE_SIZE)]  # at the anchor
    dynamics: DynamicState
    remembered: Annotated[Array, Field("f8", MAX_CORRECTIONS, fill=NAN)]  # by each correction


def initial(prepared: PreparedTendon) -> EstimatorState:
    """Return the state before the first sample."""
    state = EstimatorState.new()
    state.profile[:] = build_pretensioned_profile(prepared.tables, float(prepared.pretension))
    state.anchor_profile[:] = state.profile
    if prepared.has_dynamics:
        dynamic_correction.reset(prepared.dynamics, state.dynamics)
    return state


def initial_all(prepared: StructArray) -> StructArray:
    """Return the states of the tendons of a rig before the first sample, shape (n,)."""
    states = EstimatorState.array(len(prepared))
    for i in range(len(prepared)):
        states[i] = initial(view_struct(prepared, i))
    return states
