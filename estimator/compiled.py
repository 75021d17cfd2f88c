"""One typed decorator for everything that is compiled, so that types survive it."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` with numba: IEEE arithmetic, no GIL, cached on disk between runs."""
    return cast(Callable[P, R], numba.njit(function, cache=True, nogil=True, no_cfunc_wrapper=True))
