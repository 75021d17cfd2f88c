"""Effects along the sheath: where its bends lie, and damage at a place."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from slave.rigs.simulated.plant.effects.effect import build_ranged_field
from slave.rigs.simulated.plant.effects.ends import SideEffect
from slave.rigs.simulated.plant.joint import Tendon

BREAK_GAP = 0.3  # [m] between the ends of a broken tendon: more than a motor can close
JAMMED_CELLS = 6  # cells that hold a jammed tendon: a tension ratio of 7^6, still within rounding
JAM_FRICTION = 1.5  # friction of each, which transmits a seventh


@dataclass(frozen=True, slots=True)
class NonuniformCurvature(SideEffect):
    """The same total bend, redistributed: `ratio` times as sharp at the tip as at the housing.

    The curvature is weighted by a factor that grows exponentially along the sheath.
    """

    type: Literal["nonuniform_curvature"] = "nonuniform_curvature"
    ratio: float = build_ranged_field(4.5, 0.05, 20.0)

    def change(self, tendon: Tendon, /) -> Tendon:
        """Return the tendon with this effect added."""
        friction = tendon.chain.friction
        total = friction.sum()
        if total == 0.0:
            return tendon
        weighted = friction * np.geomspace(1.0, self.ratio, len(friction))
        weighted *= total / weighted.sum()
        return tendon._replace(chain=tendon.chain._replace(friction=weighted))


@dataclass(frozen=True, slots=True)
class BrokenTendon(SideEffect):
    """The tendon breaks at a fraction of its length from the housing."""

    type: Literal["broken_tendon"] = "broken_tendon"
    share: float = build_ranged_field(0.5, 0.0, 1.0)

    def change(self, tendon: Tendon, /) -> Tendon:
        """Return the tendon with this effect added."""
        parted = tendon.chain.parted.copy()
        parted[round(self.share * (len(parted) - 1))] = BREAK_GAP
        return tendon._replace(chain=tendon.chain._replace(parted=parted))


@dataclass(frozen=True, slots=True)
class JammedTendon(SideEffect):
    """The tendon jams in its sheath at a fraction of its length from the housing.

    By friction that no motor overcomes, given a tension on the housing's side.
    """

    type: Literal["jammed_tendon"] = "jammed_tendon"
    share: float = build_ranged_field(0.5, 0.0, 1.0)

    def change(self, tendon: Tendon, /) -> Tendon:
        """Return the tendon with this effect added."""
        friction = tendon.chain.friction.copy()
        first = round(self.share * max(0, len(friction) - JAMMED_CELLS))
        friction[first : first + JAMMED_CELLS] = JAM_FRICTION
        return tendon._replace(chain=tendon.chain._replace(friction=friction))
