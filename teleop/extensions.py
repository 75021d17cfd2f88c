"""Rigs, devices and effects of other packages, named in a config as `package.module:Name`.

An installed package may also declare a short name as an entry point, in the group `teleop.rigs`,
`teleop.devices` or `teleop.effects`. Only named extensions are imported.
"""

import importlib
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any, ClassVar

from teleop.suggestions import did_you_mean


class ExtensionError(ValueError):
    """A name is not that of an extension; the message gives reason and remedy."""


@dataclass(frozen=True)
class Extension:
    """Base of the configs of extensions; subclasses are frozen dataclasses.

    The fields of a subclass are the keys of its section in the config, checked as built-in ones
    are: a `ValueError` of its `__post_init__` becomes a line that names the place.
    """

    GROUP: ClassVar[str] = ""

    type: str = ""  # name in the config


def resolve(name: str, group: str) -> Any:
    """Return the object of a name.

    Parameters
    ----------
    name : str
        `package.module:Name`, or the name of an entry point.
    group : str
        Of entry points.

    Raises
    ------
    ExtensionError
        There is no such package, module, attribute or entry point, or importing it fails.
    """
    reference = name
    if ":" not in name:
        points = {point.name: point.value for point in entry_points(group=group)}
        if name not in points:
            raise ExtensionError(
                f"no installed package declares {name!r} in the entry points {group!r}"
                f"{did_you_mean(name, points)}"
            )
        reference = points[name]
    module_name, _, attribute = reference.partition(":")
    try:
        found = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        raise ExtensionError(
            f"{reference}: no module {error.name!r}; install its package"
        ) from None
    except Exception as error:
        raise ExtensionError(
            f"{reference}: importing {module_name} fails: {type(error).__name__}: {error}"
        ) from error
    for part in attribute.split("."):
        if not hasattr(found, part):
            hint = did_you_mean(part, dir(found))
            raise ExtensionError(f"{reference}: {module_name} has no {part!r}{hint}")
        found = getattr(found, part)
    return found


def names_of(base: type[Extension]) -> set[str]:
    """Return the entry points that installed packages declare for a kind of extension."""
    return {point.name for point in entry_points(group=base.GROUP)}


def resolve_class(name: str, base: type[Extension]) -> type[Extension]:
    """Return the class of a name; `ExtensionError` unless it is a subclass of `base`."""
    found = resolve(name, base.GROUP)
    if not (isinstance(found, type) and issubclass(found, base)):
        raise ExtensionError(f"{name}: must be a subclass of {base.__module__}:{base.__name__}")
    return found


def opening_failed(place: str, config: Extension, error: Exception) -> str:
    """Return one line on an exception raised by an extension's own code while opening."""
    message_text = " ".join(str(error).split())
    return f"{place}: {config.type} cannot be opened: {type(error).__name__}: {message_text}"
