"""What the tip of a tendon works against: a return spring, and what it meets along the way."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled

Array = NDArray[np.float64]

STIFFNESS_MAX = 1e7  # [N/m] a thousand times a tendon's own; beyond it rounding shows in the force


@dataclass(frozen=True, slots=True)
class ContactConfig:
    """Something elastic in the way of the tip: tissue, or a wall."""

    travel: float = 0.008  # [m] of the tip at which it is met
    stiffness: float = 1000.0  # [N/m] that it adds from there on

    def __post_init__(self) -> None:
        """Refuse a contact that pulls, or that is met before the start."""
        if not 0.0 <= self.travel <= 1.0:
            raise ValueError("travel: must be 0 to 1 m")
        if not 0.0 <= self.stiffness <= STIFFNESS_MAX:
            raise ValueError(f"stiffness: must be 0 to {STIFFNESS_MAX:g} N/m")


@dataclass(frozen=True, slots=True)
class TipConfig:
    """The load at the tip: soft tissue met after 8 mm of travel against a return spring."""

    pretension: float = 1.0  # [N] of the return spring, and all along the tendon, at the start
    spring: float = 200.0  # [N/m] of the return spring
    contacts: tuple[ContactConfig, ...] = (ContactConfig(),)

    def __post_init__(self) -> None:
        """Refuse a tip that nothing brings back."""
        if not 0.0 <= self.pretension <= 100.0:
            raise ValueError("pretension: must be 0 to 100 N")
        if not 1.0 <= self.spring <= STIFFNESS_MAX:
            raise ValueError(f"spring: must be 1 to {STIFFNESS_MAX:g} N/m")


class Load(NamedTuple):
    """A force that never falls with the tip's travel q [m], positive towards the housing.

    F(q) = pretension + spring q + sum over contacts of stiffness_j max(0, q - travel_j)
    """

    pretension: float  # [N] at q = 0
    spring: float  # [N/m] > 0
    contact_travel: Array  # [m] shape (contacts,)
    contact_stiffness: Array  # [N/m] shape (contacts,)


def build_load(config: TipConfig) -> Load:
    """Return the load that `config` describes."""
    return Load(
        config.pretension,
        config.spring,
        np.array([contact.travel for contact in config.contacts]),
        np.array([contact.stiffness for contact in config.contacts]),
    )


@compiled
def load_force(load: Load, travel: float) -> tuple[float, float]:
    """Return the force F(q) [N] and its slope dF/dq [N/m] at `travel` [m]."""
    force = load.pretension + load.spring * travel
    slope = load.spring
    for j in range(len(load.contact_travel)):
        depth = travel - load.contact_travel[j]
        if depth > 0.0:
            force += load.contact_stiffness[j] * depth
            slope += load.contact_stiffness[j]
    return force, slope
