"""From what a tick found to the messages that listeners get."""

import math
from collections.abc import Sequence

from estimator.compiled import compiled
from estimator.records import Records
from estimator.sheath import Sheath
from teleop import messages
from teleop.messages import MAX_SECTIONS, MAX_TENDONS, PROFILE_POINTS, padded


@compiled
def fill_tendon_state(
    layouts: Records, memories: Records, rows: Records, index: int, states: Records
) -> None:
    """Fill in a `TendonState` from one of a tick's rows, all but its head.

    Parameters
    ----------
    layouts, memories, rows : Records
        `RigLayout`, `SlaveMemory` and `EstimatedSample` of the tick.
    index : int
        Of the row.
    states : Records
        The message, shape (1,).
    """
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
        commanded = memory.motor[i] if used else 0.0
        state.commanded_displacement[i] = commanded if memory.has_motor else math.nan
        state.distal_tension[i] = estimate.distal_tension if used else 0.0
        state.distal_tension_low[i] = estimate.low if used else 0.0
        state.distal_tension_high[i] = estimate.high if used else 0.0
        state.elongation[i] = estimate.elongation if used else 0.0
        state.front[i] = estimate.front if used else 0.0
        state.phase[i] = estimate.phase if used else 0
        state.status[i] = estimate.status if used else 0
        state.bench_distal_tension[i] = row.bench_tension[i] if used else 0.0
        state.bench_distal_displacement[i] = row.bench_displacement[i] if used else 0.0


def tension_profile(
    tendon: int, length: float, front: float, tension: Sequence[float]
) -> messages.TensionProfile:
    """Return T(x) of one tendon at `PROFILE_POINTS` evenly spread points."""
    return messages.TensionProfile(
        tendon=tendon, length=length, front=front, tension=padded(tension, PROFILE_POINTS)
    )


def sheath(tendon: int, joint: int, model: Sheath) -> messages.Sheath:
    """Return the shape and constants of one sheath of at most `MAX_SECTIONS` sections."""
    sections = model.sections
    return messages.Sheath(
        tendon=tendon,
        joint=joint,
        sections=len(sections),
        effective_friction=model.K,
        axial_stiffness=model.axial_stiffness,
        section_length=padded([s.length for s in sections], MAX_SECTIONS),
        section_radius=padded([s.radius for s in sections], MAX_SECTIONS),
    )
