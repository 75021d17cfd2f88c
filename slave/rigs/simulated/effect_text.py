"""Text descriptions of effects, and warnings for those that a run did not reach."""

import dataclasses
from collections.abc import Sequence

from slave.rigs.simulated.plant.effects import EffectConfig


def describe_effect(effect: EffectConfig) -> str:
    """Return an effect in one line: name, parameters, place and start."""
    values = {field.name: getattr(effect, field.name) for field in dataclasses.fields(effect)}
    name, joint, start = (values.pop(key) for key in ("type", "joint", "start"))
    tendon = values.pop("tendon", "both")
    numbers = ", ".join(f"{key} {value}" for key, value in values.items())
    place = "every joint" if joint is None else f"joint {joint}"
    place += "" if tendon == "both" else f", tendon {tendon}"
    return f"{name} ({numbers}), {place}, from {start:g} s"


def format_late_effects(effects: Sequence[EffectConfig], span: float) -> list[str]:
    """Return a warning for each effect that starts after a run of `span` [s]."""
    return [
        f"WARNING: slave.rig.effects.{i}: {effect.type} starts at {effect.start:g} s, after the "
        f"end at {span:.3g} s: it had no effect"
        for i, effect in enumerate(effects)
        if effect.start >= span
    ]
