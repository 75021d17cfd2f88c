"""Bounds of the elongation of a tendon at a tension, for any earlier motion.

With friction the elongation at housing tension T lies between e(T) of a pull and e(T) of a release
(docs/theory.md (T2), (T4)),

    M_pull (T + tau) - tau L/EA  <=  e  <=  M_rel (T + tau) - tau L/EA.
"""

from estimator.compiled import jit_compile
from estimator.law import tables
from estimator.law.sheath import Sheath
from estimator.records import F64, Struct


class ComplianceBounds(Struct):
    """Bounds of the compliance of a tendon."""

    pull: F64 = 0.0  # M_pull [m/N]
    release: F64 = 0.0  # M_rel [m/N]
    drag: F64 = 0.0  # tau [N]
    rest: F64 = 0.0  # tau L/EA [m]


def compute_compliance(sheath: Sheath) -> ComplianceBounds:
    """Return the compliance of a tendon in a sheath."""
    table = tables.build_tables(sheath)
    K, EA, rho = table[tables.K], table[tables.EA], table[tables.ASYMMETRY]
    drag = table[tables.DRAG]
    return ComplianceBounds.new(
        pull=tables.integrate_exponential(table, K, -1.0) / EA,
        release=tables.integrate_exponential(table, K, rho) / EA,
        drag=drag,
        rest=drag * table[tables.LENGTH] / EA,
    )


@jit_compile
def compute_elongation_min(compliance: ComplianceBounds, tension: float) -> float:
    """Return the least elongation [m] of a taut tendon with `tension` [N] at the housing."""
    return max(compliance.pull * (tension + compliance.drag) - compliance.rest, 0.0)


@jit_compile
def compute_elongation_max(compliance: ComplianceBounds, tension: float) -> float:
    """Return the largest elongation [m] of a tendon with `tension` [N] at the housing."""
    return compliance.release * (max(tension, 0.0) + compliance.drag) - compliance.rest
