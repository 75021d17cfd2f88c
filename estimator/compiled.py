"""One typed decorator for everything that is compiled, so that types survive it."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` with numba: IEEE arithmetic, no GIL, cached on disk between runs."""
    # the entry for calls from C, which nobody makes, would take a sixth of the time to compile
    dispatcher = numba.njit(function, cache=True, nogil=True, no_cfunc_wrapper=True)
    return cast(Callable[P, R], dispatcher)


def compiled_in_caller(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` as a part of the one compiled function that calls it.

    For large functions that a caller is divided into: compiled apart, they would be optimised once
    for themselves and once more within their caller. Elsewhere they are `compiled`.
    """
    dispatcher = numba.njit(
        function, cache=True, nogil=True, no_cfunc_wrapper=True, inline="always"
    )
    return cast(Callable[P, R], dispatcher)
