"""Tendon-sheath transmission: its law, the estimator of tip force, calibration and diagnosis.

    import estimator as est

The public names are those of `__init__.pyi`.
"""

import ast
import importlib
import pkgutil
from typing import Any

# Names are imported when they are first used: a control loop that needs `Estimator` then loads
# neither scipy nor the diagnosis. The stub beside this file is the only list of them: type checkers
# read it as it is, and `import estimator` looks up there which module has a name (as in SPEC 1 of
# Scientific Python).
_stub = ast.parse(pkgutil.get_data(__name__, "__init__.pyi") or b"")
_module_of = {
    alias.name: statement.module
    for statement in _stub.body
    if isinstance(statement, ast.ImportFrom) and statement.module
    for alias in statement.names
}

__all__ = sorted(_module_of)  # noqa: PLE0605 (the list is in the stub)


def __getattr__(name: str) -> Any:
    """Import a public name from its module (PEP 562)."""
    if name not in _module_of:
        raise AttributeError(f"module 'estimator' has no attribute {name!r}")
    return getattr(importlib.import_module(_module_of[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
