"""Public names of a package, imported when they are first used.

A control loop that needs `Estimator` then loads neither scipy nor the diagnosis. The stub
`__init__.pyi` beside the package's `__init__.py` is the only list of the names: type checkers read
it as it is, and here it says which module has a name (as in SPEC 1 of Scientific Python).
"""

import ast
import importlib
import pkgutil
from collections.abc import Callable
from functools import cache
from typing import Any


def attach_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` (PEP 562) of a package with a stub.

    The stub is read at the first name that is asked for, `__all__` among them.
    """

    def get_name(name: str) -> Any:
        if name == "__all__":
            return list_names()
        if name.startswith("__") or name not in _read_stub(package):
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(_read_stub(package)[name]), name)

    def list_names() -> list[str]:
        return sorted(_read_stub(package))

    return get_name, list_names


@cache
def _read_stub(package: str) -> dict[str, str]:
    """Return the module of each public name of a package."""
    stub = ast.parse(pkgutil.get_data(package, "__init__.pyi") or b"")
    return {
        alias.name: statement.module
        for statement in stub.body
        if isinstance(statement, ast.ImportFrom) and statement.module
        for alias in statement.names
    }
