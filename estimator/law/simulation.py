"""The law of a sheath driven through a course of tensions at the housing."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from estimator.array_types import Array
from estimator.law.sheath import Sheath, SheathError
from estimator.law.transmission import build_slack_profile, build_tables, simulate_tensions


class Simulation(NamedTuple):
    """What the law says, arrays of shape (n,)."""

    distal_tension: Array  # T_out [N]
    elongation: Array  # e [m] of tendon and sheath


def simulate(sheath: Sheath, proximal_tension: ArrayLike) -> Simulation:
    """Return tension at the tip and elongation of a tendon pulled at the housing.

    The tendon starts slack; the tip is held still, and whatever the order of pulls and releases,
    reversals at any depth are followed (play operators, docs/theory.md section 3; Phee et al. 2009
    eq. (1) to (12) are its first pull and release).

    Parameters
    ----------
    sheath : Sheath
        Geometry, friction and stiffness.
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
