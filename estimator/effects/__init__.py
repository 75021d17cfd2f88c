"""What real transmissions do beyond the paper's model: the catalogue, one file a family.

A new effect is an `Effect` in the file of its family and an entry in that file's EFFECTS;
docs/how-to/diagnose.md shows one from beginning to end.
"""

from estimator.effects import elasticity, ends, friction, sensors
from estimator.effects.effect import CHANNELS, Effect, EffectContext, Parameter, Signals, Values

__all__ = [
    "CATALOGUE",
    "CHANNELS",
    "NAMES",
    "Effect",
    "EffectContext",
    "Parameter",
    "Signals",
    "Values",
]

CATALOGUE: tuple[Effect, ...] = (
    *friction.EFFECTS,
    *elasticity.EFFECTS,
    *ends.EFFECTS,
    *sensors.EFFECTS,
)
"""Every effect in every variant."""

NAMES: tuple[str, ...] = tuple(dict.fromkeys(effect.name for effect in CATALOGUE))
"""Of the effects, each once."""
