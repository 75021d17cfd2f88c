"""Base laws of a transmission: how friction goes with the load.

* capstan: dT/ds = -/+ T, s from 0 to K; contacts of a tendon are rigid, those of a loop's cables
  have a presliding width;
* load-independent: dT/ds = -/+ F, s from 0 to 1, F the friction of the whole sheath [N]; contacts
  give elastically before they slide, over the presliding width (Dahl 1968);
* both: dT/ds = -/+ (T + F/K), with a presliding width.
"""

from collections.abc import Mapping
from enum import StrEnum

import numpy as np

from estimator.effects.effect import Parameter
from estimator.lumped.lumped_model import Physics

FRICTION = Parameter("K", "", 0.01, 5.0, 0.05)
FRICTION_FORCE = Parameter("friction", "N", 1e-3, 200.0, 0.05)  # of a whole sheath, at any load
PRESLIDING_WIDTH = Parameter("presliding width", "m", 1e-7, 5e-3, 5e-6, None)

_LOAD_INDEPENDENT_K = 1e-3  # K of friction that no load changes: to within 0.1 % of the load


class BaseLaw(StrEnum):
    """Base laws."""

    CAPSTAN = "capstan"
    INDEPENDENT = "load-independent"
    BOTH = "capstan and load-independent"


_PARAMETERS: Mapping[BaseLaw, tuple[Parameter, ...]] = {
    BaseLaw.CAPSTAN: (FRICTION,),
    BaseLaw.INDEPENDENT: (FRICTION_FORCE, PRESLIDING_WIDTH),
    BaseLaw.BOTH: (FRICTION, FRICTION_FORCE, PRESLIDING_WIDTH),
}


def list_law_parameters(law: BaseLaw, loop: bool) -> tuple[Parameter, ...]:
    """Return the parameters of a law, before those of elasticity and load."""
    return (FRICTION, PRESLIDING_WIDTH) if loop and law is BaseLaw.CAPSTAN else _PARAMETERS[law]


EXCLUDED_EFFECTS: Mapping[BaseLaw, frozenset[str]] = {
    BaseLaw.CAPSTAN: frozenset(),
    BaseLaw.INDEPENDENT: frozenset({"constant_drag", "presliding", "tension_dependent_friction"}),
    BaseLaw.BOTH: frozenset({"constant_drag", "presliding"}),
}
"""Effects that a law has in it already, or that are defined on another only."""


def apply_base_law(physics: Physics, law: BaseLaw, values: Mapping[str, float]) -> Physics:
    """Return a tendon with the friction of a law; `values` by name of `list_law_parameters`."""
    ones, width = np.ones_like(physics.friction), values.get(PRESLIDING_WIDTH.name, 0.0)
    if law is BaseLaw.CAPSTAN:
        return physics._replace(friction=values[FRICTION.name] * ones, presliding=width)
    K = _LOAD_INDEPENDENT_K if law is BaseLaw.INDEPENDENT else values[FRICTION.name]
    return physics._replace(
        friction=K * ones, drag=values[FRICTION_FORCE.name] / K, presliding=width
    )
