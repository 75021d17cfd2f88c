"""One typed decorator for everything that is compiled, so that types survive it.

Some code is written for the compiler or for the type checker, here and in the loops:

* `fields: Any = record`: type checkers know the items of a record's array as read-only, or a
  record as an array of them; compiled code writes to them.
* `if with_dynamics is None`: numba omits a branch on an argument that is None.
"""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

from estimator import compile_cache

_folder = compile_cache.choose_folder()  # numba reads it from the environment when it is imported

import numba  # noqa: E402
from numba.core import types  # noqa: E402
from numba.extending import lower_cast  # noqa: E402

if _folder is not None:
    # somebody else may have imported it before
    numba.config.CACHE_DIR = str(_folder)  # type: ignore[attr-defined]

P = ParamSpec("P")
R = TypeVar("R")

# Without the entry for calls from C, which nobody makes: a sixth of the time that compiling takes.
# Of any type, as the option is missing in numba's own.
_NUMBA_OPTIONS: dict[str, Any] = {
    "cache": _folder is not None,
    "nogil": True,
    "no_cfunc_wrapper": True,
}


def jit_compile(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` with numba: IEEE arithmetic, no GIL, cached on disk where that is safe."""
    dispatcher = numba.njit(function, **_NUMBA_OPTIONS)
    get_call_template = dispatcher.get_call_template

    def get_common_template(arguments: Any, keywords: Any) -> Any:
        keywords = {name: _to_common_type(argument) for name, argument in keywords.items()}
        return get_call_template(tuple(map(_to_common_type, arguments)), keywords)

    dispatcher.get_call_template = get_common_template
    return cast(Callable[P, R], dispatcher)


def _to_common_type(argument: Any) -> Any:
    """Return the type that compiled callers give an argument, so that one version serves them all.

    An array within a record is an array like any other, and a literal is a number: numba would
    compile a function, and all that it calls, once more for each.
    """
    if isinstance(argument, types.NestedArray):
        return types.Array(argument.dtype, argument.ndim, "C")
    return types.unliteral(argument)  # type: ignore[no-untyped-call]


@lower_cast(types.NestedArray, types.Array)  # type: ignore[no-untyped-call, untyped-decorator]
def _cast_nested_array(_context: Any, _builder: Any, _from: Any, _to: Any, value: R) -> R:
    return value


def jit_inline(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` as a part of the one compiled function that calls it.

    For large functions that a caller is divided into: compiled apart, they would be optimised once
    for themselves and once more within their caller. Elsewhere they are `jit_compile`.
    """
    return cast(Callable[P, R], numba.njit(function, inline="always", **_NUMBA_OPTIONS))
