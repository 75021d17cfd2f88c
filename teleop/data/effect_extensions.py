"""Effects of other packages, for diagnoses and model files."""

from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import entry_points

from estimator.effects import Effect
from teleop.config.extensions import ExtensionError, resolve_object
from teleop.errors import UsageError

ENTRY_POINT_GROUP = "teleop.effects"


def is_extension(name: str) -> bool:
    """Return whether a name is `package.module:NAME`, or an entry point for effects."""
    return ":" in name or any(point.name == name for point in entry_points(group=ENTRY_POINT_GROUP))


def load_effects(name: str, origin: str = "--effects") -> tuple[Effect, ...]:
    """Return the effect, or its variants, by name, which it keeps in model files.

    Raises `UsageError` if the name is not that of an effect.
    """
    try:
        loaded = resolve_object(name, ENTRY_POINT_GROUP)
    except ExtensionError as error:
        raise UsageError(f"{origin}: {error}") from error
    effects = (loaded,) if isinstance(loaded, Effect) else loaded
    if not (
        isinstance(effects, Sequence)
        and effects
        and all(isinstance(effect, Effect) for effect in effects)
    ):
        raise UsageError(f"{origin}: {name} must be an estimator.effects.Effect, or several")
    return tuple(replace(effect, name=name) for effect in effects)
