"""Fill the messages for listeners from the records of a tick."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import jit_compile
from estimator.law.sheath import Sheath
from estimator.law.transmission import evaluate_tension
from estimator.structs import StructArray
from slave.adaptation import TendonFriction
from teleop.messages import messages
from teleop.messages.messages import MAX_MESSAGE_SECTIONS, MAX_TENDONS, PROFILE_POINTS, pad_values

Array = NDArray[np.float64]


@jit_compile
def fill_tendon_state(
    layouts: StructArray, memories: StructArray, rows: StructArray, index: int, states: StructArray
) -> None:
    """Fill in a `TendonState`, shape (1,), from a row of a tick, except for its head."""
    memory, row, state = memories[0], rows[index], states[0]
    count = layouts[0].tendons
    state.tendons = count
    state.time_s = row.time_s
    for i in range(MAX_TENDONS):
        tendon = row.tendons[i]
        estimate = tendon.estimate
        used = i < count
        state.proximal_tension[i] = tendon.tension if used else 0.0
        state.proximal_displacement[i] = tendon.displacement if used else 0.0
        commanded = memory.gated_position[i] if used else 0.0
        state.commanded_displacement[i] = commanded if memory.has_gated_position else math.nan
        state.distal_tension[i] = estimate.distal_tension if used else 0.0
        state.distal_tension_low[i] = estimate.low if used else 0.0
        state.distal_tension_high[i] = estimate.high if used else 0.0
        state.elongation[i] = estimate.elongation if used else 0.0
        state.front[i] = estimate.front if used else 0.0
        state.phase[i] = estimate.phase if used else 0
        state.status[i] = estimate.status if used else 0
        state.bench_distal_tension[i] = row.bench_tension[i] if used else 0.0
        state.bench_distal_displacement[i] = row.bench_displacement[i] if used else 0.0


@jit_compile
def fill_tension_profile(
    prepared: StructArray,
    estimators: StructArray,
    memories: StructArray,
    tendon: int,
    points: Array,
    profiles: StructArray,
) -> None:
    """Fill in a `TensionProfile`, shape (1,), of one tendon, from 0, except for its head.

    `points` [m], shape (PROFILE_POINTS,), are arc lengths, evenly spread over its sheath.
    """
    profile: Any = profiles[0]
    profile.tendon = tendon
    profile.length = points[PROFILE_POINTS - 1]
    profile.front = memories[0].tendons[tendon].estimate.front
    tension = evaluate_tension(prepared[tendon].tables, estimators[tendon].profile, points)
    for i in range(PROFILE_POINTS):
        profile.tension[i] = tension[i]


def build_sheath_message(
    tendon: int, joint: int, model: Sheath, friction: TendonFriction
) -> messages.Sheath:
    """Return the shape and constants of one sheath of at most `MAX_MESSAGE_SECTIONS` sections."""
    sections = model.sections
    return messages.Sheath(
        tendon=tendon,
        joint=joint,
        sections=len(sections),
        effective_friction=friction.K,
        friction_low=friction.low,
        friction_high=friction.high,
        axial_stiffness=model.axial_stiffness,
        section_length=pad_values([s.length for s in sections], MAX_MESSAGE_SECTIONS),
        section_radius=pad_values([s.radius for s in sections], MAX_MESSAGE_SECTIONS),
    )
