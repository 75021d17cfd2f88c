"""What other packages have, named in a config or a model file: rigs, devices, effects and methods.

An installed package declares them as entry points, in a group such as `teleop.rigs` (`GROUP` of an
`Extension`) or `teleop.effects`; a file may name these, and only what is named is imported. Any
other code, as `package.module:Name`, only if the user allows it: the file may be somebody else's.
"""

import importlib
import sys
import traceback
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, ClassVar

from teleop.config.options import ALLOW_IMPORTS
from teleop.config.suggestions import suggest_spelling
from teleop.errors import UsageError
from teleop.runtime.process import print_warning


@dataclass
class ImportPolicy:
    """What this process imports because a config or a model file names it."""

    any_module: bool = False  # `package.module:Name`, besides entry points of installed packages
    # classes of objects that this program has put into a config, by their names there
    classes: dict[str, type[Any]] = field(default_factory=dict)


policy = ImportPolicy()


def allow_imports() -> None:
    """Let configs and model files name any code as `package.module:Name`, in this process."""
    policy.any_module = True


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


def resolve_object(name: str, group: str) -> Any:
    """Return the object of a name, which is imported.

    The `name` is `package.module:Name`, or that of an entry point in the `group`.

    Raises `ExtensionError` if there is no such package, module, attribute or entry point, importing
    it fails, or it is neither an entry point nor allowed (`allow_imports`).
    """
    if name in policy.classes:
        return policy.classes[name]
    reference = name
    points = {point.name: point.value for point in entry_points(group=group)}
    if ":" not in name:
        if name not in points:
            raise ExtensionError(
                f"no installed package declares {name!r} in the entry points {group!r}"
                f"{suggest_spelling(name, points)}"
            )
        reference = points[name]
    elif not policy.any_module and name not in points.values():
        raise ExtensionError(
            f"{name} is code that no installed package declares in the entry points {group!r}; if "
            f"you trust this file and that package, add {ALLOW_IMPORTS}"
        )
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
            hint = suggest_spelling(part, dir(found))
            raise ExtensionError(f"{reference}: {module_name} has no {part!r}{hint}")
        found = getattr(found, part)
    return found


def list_entry_points(base: type[Extension]) -> set[str]:
    """Return the entry points that installed packages declare for a kind of extension."""
    return {point.name for point in entry_points(group=base.GROUP)}


def resolve_class(name: str, base: type[Extension]) -> type[Extension]:
    """Return the class of a name; `ExtensionError` unless it is a subclass of `base`."""
    found = resolve_object(name, base.GROUP)
    if not (isinstance(found, type) and issubclass(found, base)):
        raise ExtensionError(f"{name}: must be a subclass of {base.__module__}:{base.__name__}")
    return found


def name_class(config: Extension) -> str:
    """Return the name in a config of an extension's class: its own, or `package.module:Name`.

    That of a script is the module of its file: it is imported where the extension is used, so what
    it runs belongs below `if __name__ == "__main__"`.

    Raises `UsageError` if another process cannot import the class: it is not defined in a file.
    """
    if config.type:
        return config.type
    cls = type(config)
    module, name = cls.__module__, cls.__qualname__
    if module == "__main__":
        main = sys.modules[module]
        file = getattr(main, "__file__", None)
        spec = main.__spec__
        module = spec.name if spec is not None else Path(file or "").stem
    if not module or "<locals>" in name:
        raise UsageError(
            f"{name}: another process cannot import it; define the class at the top of a file"
        )
    policy.classes[f"{module}:{name}"] = cls
    return f"{module}:{name}"


def format_call_failure(place: str, method: str, error: Exception) -> str:
    """Return one line on an exception of an extension's own code, with the place in its code."""
    message_text = " ".join(str(error).split())
    frame = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{frame.filename}, line {frame.lineno}"
    return f"{place}: {method} fails: {type(error).__name__}: {message_text} ({where})"


def format_opening_failure(place: str, config: Extension, error: Exception) -> str:
    """Return one line on an exception raised by an extension's own code while opening."""
    message_text = " ".join(str(error).split())
    return f"{place}: {config.type} cannot be opened: {type(error).__name__}: {message_text}"


def close_extension(place: str, opened: Any) -> None:
    """Close a rig or device; an exception of its code is a warning, as it would hide others."""
    try:
        opened.close()
    except Exception as error:
        print_warning(
            f"{format_call_failure(place, 'close', error)}: check that its motors are without power"
        )
