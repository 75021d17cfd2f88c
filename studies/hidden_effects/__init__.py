"""Records of a bench with effects that a diagnosis has to find: make(seed, effects, size, bench).

`Hidden.channels` is what a diagnosis may see, `Hidden.truth` what it must say. EFFECTS and OUTSIDE
name what can be hidden, inside and outside the catalogue; VISIBLE[name] the benches that have it,
BY[name] the function that is to be found of it.
Travels are positive towards the housing, and 0 where the slack tendon is just taut and the tip's
spring relaxed. Nothing is shared with `estimator` or `slave`: springs, beads, and a seed.
"""

from studies.hidden_effects import free_curves
from studies.hidden_effects.effects import EFFECTS, OUTSIDE
from studies.hidden_effects.free_curves import BY
from studies.hidden_effects.session import CHANNELS, Hidden, make

VISIBLE = {name: e.benches for name, e in (EFFECTS | OUTSIDE).items()}

__all__ = ["BY", "CHANNELS", "EFFECTS", "OUTSIDE", "VISIBLE", "Hidden", "free_curves", "make"]
