"""What theory.md says of a profile and nothing but tests evaluates: slopes and bounds."""

from estimator.law.play_profile import Profile, from_log_tension, to_log_tension
from estimator.law.tables import ASYMMETRY, K, Tables
from estimator.law.transmission import find_front


def envelope(tables: Tables, T_in: float) -> tuple[float, float]:
    """Return the least and largest T_out [N] that `T_in` [N] alone allows, any history (T2)."""
    return cone(tables, to_log_tension(tables, T_in), tables[K])


def certified_interval(tables: Tables, profile: Profile) -> tuple[float, float]:
    """Return the least and largest T_out [N] that moving the motor has not excluded.

    While T_in moves and q_p agrees with the model (T19), the front is where the profile has it, at
    depth a, and the tension T(a) there is certain. The tip may have been driven meanwhile, but its
    own front cannot have come nearer than a, so T_out lies in the cone of (T2) that starts there:
    [T(a) e^-(K-a), T(a) e^(rho (K-a))], every value of which the tip can take unseen. It is one
    point once the motor's front has reached the tip. Where the motor has held still while the tip
    could move, nothing of the profile is certain but T_in: use `envelope`.
    """
    s, y = find_front(profile)
    return cone(tables, y, tables[K] - s)


def cone(tables: Tables, y: float, ds: float) -> tuple[float, float]:
    """Return the tensions [N] that friction allows `ds` further down from log tension `y`."""
    return from_log_tension(tables, y - ds), from_log_tension(tables, y + tables[ASYMMETRY] * ds)
