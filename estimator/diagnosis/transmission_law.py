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
FORCE = Parameter("friction", "N", 1e-3, 200.0, 0.05)  # of a whole sheath, at any load
WIDTH = Parameter("presliding width", "m", 1e-7, 5e-3, 5e-6, None)

_ANY_LOAD = 1e-3  # K of friction that no load changes: to within 0.1 % of the load


class Law(StrEnum):
    """Base laws."""

    CAPSTAN = "capstan"
    INDEPENDENT = "load-independent"
    BOTH = "capstan and load-independent"


_PARAMETERS: Mapping[Law, tuple[Parameter, ...]] = {
    Law.CAPSTAN: (FRICTION,),
    Law.INDEPENDENT: (FORCE, WIDTH),
    Law.BOTH: (FRICTION, FORCE, WIDTH),
}


def parameters_of(law: Law, loop: bool) -> tuple[Parameter, ...]:
    """Return the parameters of a law, before those of elasticity and load."""
    return (FRICTION, WIDTH) if loop and law is Law.CAPSTAN else _PARAMETERS[law]


CONTAINED: Mapping[Law, frozenset[str]] = {
    Law.CAPSTAN: frozenset(),
    Law.INDEPENDENT: frozenset({"constant_drag", "presliding", "tension_dependent_friction"}),
    Law.BOTH: frozenset({"constant_drag", "presliding"}),
}
"""Effects that a law has in it already, or that are defined on another only."""


def with_friction(physics: Physics, law: Law, values: Mapping[str, float]) -> Physics:
    """Return a tendon with the friction of a law; `values` by name of `parameters_of`."""
    ones, width = np.ones_like(physics.friction), values.get(WIDTH.name, 0.0)
    if law is Law.CAPSTAN:
        return physics._replace(friction=values[FRICTION.name] * ones, presliding=width)
    K = _ANY_LOAD if law is Law.INDEPENDENT else values[FRICTION.name]
    return physics._replace(friction=K * ones, drag=values[FORCE.name] / K, presliding=width)
