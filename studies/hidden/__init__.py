"""Records of a bench with effects that a diagnosis has to find: make(seed, effects, size, bench).

`Hidden.channels` is what a diagnosis may see, `Hidden.truth` what it must say. EFFECTS and OUTSIDE
name what can be hidden, inside and outside the catalogue; VISIBLE[name] the benches that have it.
Travels are positive towards the housing, and 0 where the slack tendon is just taut and the tip's
spring relaxed. Nothing is shared with `estimator` or `slave`: springs, beads, and a seed.
"""

from studies.hidden.effects import EFFECTS, OUTSIDE, VISIBLE
from studies.hidden.session import CHANNELS, Hidden, make

__all__ = ["CHANNELS", "EFFECTS", "OUTSIDE", "VISIBLE", "Hidden", "make"]
