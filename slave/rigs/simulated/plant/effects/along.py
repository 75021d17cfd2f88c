"""Effects along the sheath: where its bends lie, and damage at a place."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from slave.rigs.simulated.plant.effects.effect import ranged
from slave.rigs.simulated.plant.effects.ends import SideEffect
from slave.rigs.simulated.plant.joint import Tendon

GAP = 0.3  # [m] between the ends of a broken tendon: more than a motor can close
JAM = 6  # cells that hold a jammed one: tensions differ by 7^6, and still do not drown in rounding
JAMMED = 1.5  # friction of each, which lets through a seventh


@dataclass(frozen=True, slots=True)
class NonuniformCurvature(SideEffect):
    """The same bend in all, but elsewhere: `ratio` times as sharp at the tip as at the housing.

    Curvature, as described, is weighted by a factor that grows by equal ratios along the sheath.
    """

    type: Literal["nonuniform_curvature"] = "nonuniform_curvature"
    ratio: float = ranged(4.5, 0.05, 20.0)

    def change(self, tendon: Tendon, /) -> Tendon:
        """Return the tendon with this effect on top."""
        friction = tendon.chain.friction
        total = friction.sum()
        if total == 0.0:
            return tendon
        weighted = friction * np.geomspace(1.0, self.ratio, len(friction))
        weighted *= total / weighted.sum()
        return tendon._replace(chain=tendon.chain._replace(friction=weighted))


@dataclass(frozen=True, slots=True)
class BrokenTendon(SideEffect):
    """The tendon parts at a share of its length from the housing."""

    type: Literal["broken_tendon"] = "broken_tendon"
    share: float = ranged(0.5, 0.0, 1.0)

    def change(self, tendon: Tendon, /) -> Tendon:
        """Return the tendon with this effect on top."""
        parted = tendon.chain.parted.copy()
        parted[round(self.share * (len(parted) - 1))] = GAP
        return tendon._replace(chain=tendon.chain._replace(parted=parted))


@dataclass(frozen=True, slots=True)
class JammedTendon(SideEffect):
    """The tendon is held in its sheath, at a share of its length from the housing.

    By friction that no motor overcomes, which needs a tension on the housing's side.
    """

    type: Literal["jammed_tendon"] = "jammed_tendon"
    share: float = ranged(0.5, 0.0, 1.0)

    def change(self, tendon: Tendon, /) -> Tendon:
        """Return the tendon with this effect on top."""
        friction = tendon.chain.friction.copy()
        first = round(self.share * max(0, len(friction) - JAM))
        friction[first : first + JAM] = JAMMED
        return tendon._replace(chain=tendon.chain._replace(friction=friction))
