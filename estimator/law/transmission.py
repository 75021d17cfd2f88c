"""The transmission law of a tendon in its sheath: what the housing does, the tip feels.

State in, state out: `build_tables` prepares a sheath, `build_slack_profile` or
`build_pretensioned_profile` gives the first profile, `drive_proximal` returns the next one,
`observe` reads it. The functions named push_*
are steps in place from either end, for loops that are compiled themselves or that own their
profile. The law is the play operator of docs/explanation/theory.md (T10), (T11), (T18); Phee et al.
2009, eqs. (1)-(25) are its special cases of one pull and one release.
"""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.law import tables as _tables
from estimator.law.displacement import push_displacement, push_displacement_spring
from estimator.law.play_profile import (
    CAPACITY,
    FLOOR,
    Profile,
    build_pretensioned_profile,
    build_slack_profile,
    count_points,
    from_log_tension,
    get_merge_error_bound,
    get_point,
    integrate_tension,
    push_distal,
    push_proximal,
)
from estimator.law.sheath import Sheath, SheathError
from estimator.law.tables import (
    Tables,
    build_tables,
    compute_arc_length,
    compute_friction_coordinate,
)

__all__ = [
    "CAPACITY",
    "FLOOR",
    "SLACK_TENSION",
    "Observation",
    "Phase",
    "Profile",
    "Tables",
    "build_pretensioned_profile",
    "build_slack_profile",
    "build_tables",
    "drive_proximal",
    "evaluate_tension",
    "find_front",
    "get_merge_error_bound",
    "observe",
    "push_displacement",
    "push_displacement_spring",
    "push_distal",
    "push_proximal",
    "read_profile",
    "simulate_tensions",
]

SLACK_TENSION = 1e-6
"""T_in [N] up to which the tendon counts as slack."""

_LENGTH, _EA, _DRAG = _tables.LENGTH, _tables.EA, _tables.DRAG


class Phase(IntEnum):
    """What the tendon does next to the motor, by the paper's names.

    PULL and RELEASE: the whole tendon slides, the tip follows the motor. PULL_TO_RELEASE and
    RELEASE_TO_PULL: the front is inside the sheath, the tip does not know yet. VIRGIN: likewise,
    but the front runs into a part that has not slid since it was pretensioned. SLACK: no tension.
    """

    SLACK = 0
    VIRGIN = 1
    PULL = 2
    PULL_TO_RELEASE = 3
    RELEASE = 4
    RELEASE_TO_PULL = 5


_SLACK, _VIRGIN = int(Phase.SLACK), int(Phase.VIRGIN)
_PULL, _PULL_TO_RELEASE = int(Phase.PULL), int(Phase.PULL_TO_RELEASE)
_RELEASE, _RELEASE_TO_PULL = int(Phase.RELEASE), int(Phase.RELEASE_TO_PULL)


class Observation(NamedTuple):
    """What a profile says about both ends."""

    T_in: float
    """Tension at the housing [N]."""
    T_out: float
    """Tension at the tip [N]."""
    elongation: float
    """e [m]: travel at the motor that does not arrive at the tip."""
    phase: Phase
    front: float
    """X' [m]: how far from the housing the last change of T_in has come; L once the tip follows."""
    T_front: float
    """Tension at the front [N]: the peak of a release, the trough of a pull."""


def drive_proximal(tables: Tables, profile: Profile, tension: float) -> Profile:
    """Return the profile after the motor has brought T_in to `tension` [N]."""
    if not math.isfinite(tension):
        raise SheathError(f"tension: {tension} N, must be finite")
    driven = profile.copy()
    push_proximal(tables, driven, tension)
    return driven


def observe(tables: Tables, profile: Profile) -> Observation:
    """Return tensions, elongation, phase and front of `profile`."""
    T_in, T_out, elongation, phase, front = read_profile(tables, profile)
    _, y = find_front(profile)
    return Observation(T_in, T_out, elongation, Phase(phase), front, from_log_tension(tables, y))


@jit_compile
def read_profile(tables: Tables, profile: Profile) -> tuple[float, float, float, int, float]:
    """Return (T_in [N], T_out [N], elongation [m], phase, front X' [m])."""
    count = count_points(profile)
    _, y_in, slope = get_point(profile, 0)
    _, y_out, _ = get_point(profile, count - 1)
    s_front, _, slope_beyond = get_point(profile, 1)
    T_in = from_log_tension(tables, y_in)
    stretch = integrate_tension(tables, profile) - tables[_DRAG] * tables[_LENGTH]
    front = compute_arc_length(tables, s_front)
    if count == 2:
        phase = _PULL if slope < 0.0 else _RELEASE
    else:
        phase = _RELEASE_TO_PULL if slope < 0.0 else _PULL_TO_RELEASE
    if slope == 0.0:
        phase, front = _VIRGIN, 0.0
    elif count > 2 and slope_beyond == 0.0:
        phase = _VIRGIN
    if T_in <= SLACK_TENSION:
        phase = _SLACK
    return T_in, from_log_tension(tables, y_out), max(stretch, 0.0) / tables[_EA], phase, front


@jit_compile
def find_front(profile: Profile) -> tuple[float, float]:
    """Return (a, y(a)): friction coordinate of the proximal front and ln(T + tau) there."""
    if get_point(profile, 0)[2] == 0.0:
        s, y, _ = get_point(profile, 0)
    else:
        s, y, _ = get_point(profile, 1)
    return s, y


@jit_compile
def evaluate_tension(tables: Tables, profile: Profile, x: Array) -> Array:
    """Return T(x) [N] at the arc lengths `x` [m], shape (n,), in any order."""
    tensions = np.empty(x.size)
    last = count_points(profile) - 1
    for i in range(x.size):
        s = compute_friction_coordinate(tables, x[i])
        low, high = 0, last
        while high - low > 1:
            middle = (low + high) // 2
            if get_point(profile, middle)[0] <= s:
                low = middle
            else:
                high = middle
        s_a, y_a, slope = get_point(profile, low)
        tensions[i] = from_log_tension(tables, y_a + slope * (s - s_a))
    return tensions


@jit_compile
def simulate_tensions(tables: Tables, profile: Profile, tensions: Array) -> tuple[Array, Array]:
    """Drive T_in through `tensions` [N], shape (n,); return T_out [N] and elongation [m].

    The profile is advanced in place, so a long record can be given in pieces. A sample that is not
    finite raises ValueError, as holding the value would hide a gap in a record.
    """
    T_out = np.empty(tensions.size)
    elongation = np.empty(tensions.size)
    for i in range(tensions.size):
        if not math.isfinite(tensions[i]):
            raise ValueError("batch: a tension is not finite")
        push_proximal(tables, profile, tensions[i])
        _, y_out, _ = get_point(profile, count_points(profile) - 1)
        T_out[i] = from_log_tension(tables, y_out)
        stretch = integrate_tension(tables, profile) - tables[_DRAG] * tables[_LENGTH]
        elongation[i] = max(stretch, 0.0) / tables[_EA]
    return T_out, elongation


# --- the law of a sheath driven through a course of tensions at the housing


class Simulation(NamedTuple):
    """What the law says, arrays of shape (n,)."""

    distal_tension: Array  # T_out [N]
    elongation: Array  # e [m] of tendon and sheath


def simulate(sheath: Sheath, proximal_tension: ArrayLike) -> Simulation:
    """Return tension at the tip and elongation of a tendon pulled at the housing.

    The tendon starts slack; the tip is held still, and whatever the order of pulls and releases,
    reversals at any depth are followed (play operators, docs/explanation/theory.md section 3; Phee
    et al. 2009 eq. (1) to (12) are its first pull and release).

    Parameters
    ----------
    proximal_tension : array_like
        T_in [N], shape (n,), in order of time, not negative and finite.

    Raises
    ------
    SheathError
        If a tension is negative or not finite.
    """
    T = np.ascontiguousarray(proximal_tension, dtype=np.float64)
    if T.ndim != 1 or not (np.isfinite(T) & (T >= 0.0)).all():
        raise SheathError("proximal_tension: give one row of finite tensions from 0 N on")
    law = build_tables(sheath)
    return Simulation(*simulate_tensions(law, build_slack_profile(law), T))
