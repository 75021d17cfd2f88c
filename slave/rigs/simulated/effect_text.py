"""Effects in words: what they are, and which of them a run was too short for."""

import dataclasses
from collections.abc import Sequence

from slave.rigs.simulated.plant.effects import EffectConfig


def describe_effect(effect: EffectConfig) -> str:
    """Return an effect in one line: its name, its numbers, where and since when."""
    values = {field.name: getattr(effect, field.name) for field in dataclasses.fields(effect)}
    name, joint, start = (values.pop(key) for key in ("type", "joint", "start"))
    tendon = values.pop("tendon", "both")
    numbers = ", ".join(f"{key} {value}" for key, value in values.items())
    place = "every joint" if joint is None else f"joint {joint}"
    place += "" if tendon == "both" else f", tendon {tendon}"
    return f"{name} ({numbers}), {place}, from {start:g} s"


def late(effects: Sequence[EffectConfig], span: float) -> list[str]:
    """Return a warning for each effect that a run of `span` [s] had no time for."""
    return [
        f"WARNING: slave.rig.effects.{i}: {effect.type} starts at {effect.start:g} s, after the "
        f"end at {span:.3g} s: it was never on"
        for i, effect in enumerate(effects)
        if effect.start >= span
    ]
