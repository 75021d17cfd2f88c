"""Public names of a package, imported when they are first used.

A control loop that needs `Estimator` then loads neither scipy nor the diagnosis. The stub
`__init__.pyi` beside the package's `__init__.py` is the only list of the names: type checkers read
it as it is, and here it says which module has a name (as in SPEC 1 of Scientific Python).
"""

import ast
import importlib
import pkgutil
from collections.abc import Callable
from typing import Any


def attach_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` (PEP 562) and `__all__` of a package with a stub."""
    stub = ast.parse(pkgutil.get_data(package, "__init__.pyi") or b"")
    module_of = {
        alias.name: statement.module
        for statement in stub.body
        if isinstance(statement, ast.ImportFrom) and statement.module
        for alias in statement.names
    }
    names = sorted(module_of)

    def get_name(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(module_of[name]), name)

    return get_name, lambda: names, names
