"""Parser of `--effects`."""

from collections.abc import Sequence

from estimator.effects import CATALOGUE, NAMES, Effect
from teleop.config.suggestions import suggest_spelling
from teleop.data.effect_extensions import is_extension, load_effects
from teleop.errors import UsageError


def parse_effects(text: str) -> Sequence[Effect]:
    """Return the effects of `--effects`: comma-separated names, or all."""
    if text.strip() == "all":
        return CATALOGUE
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise UsageError("--effects: names of effects with commas between them, or all")
    others = tuple(effect for name in names if is_extension(name) for effect in load_effects(name))
    for name in names:
        if name not in NAMES and not is_extension(name):
            listed = suggest_spelling(name, NAMES, 3, 0.5) or f"; there are {', '.join(NAMES)}"
            raise UsageError(f"--effects {name}: no such effect{listed}")
    return (*(effect for effect in CATALOGUE if effect.name in names), *others)
