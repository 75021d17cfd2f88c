"""Calls of extensions inside a loop: what they return is checked before anything uses it."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from estimator.array_types import Array
from teleop.config.extensions import Extension, format_call_failure, format_opening_failure
from teleop.errors import TeleopError, UsageError
from teleop.runtime.clock import now_ns
from teleop.session.slow_calls import SlowCallMonitor

LATE_NS = 20_000_000  # [ns] of a call; below the timeouts of both sides, so it is noticed first


class ExtensionFault(TeleopError):
    """A call of an extension in a session failed; the message gives place and remedy."""


class CheckedExtension:
    """An open extension of a loop, whose mistakes are an `ExtensionFault` that names them.

    `key` is its place in the config, for messages, `config` names it; `open_it` returns the object,
    which must have all `methods`. Raises `UsageError` if it cannot be opened, or lacks a method.
    """

    def __init__(
        self, key: str, config: Extension, open_it: Callable[[], Any], *methods: str
    ) -> None:
        try:
            self._opened = open_it()
        except Exception as error:
            raise UsageError(format_opening_failure(key, config, error)) from error
        self._key, self._owner = key, f"{key}: {type(self._opened).__name__}"
        missing = [name for name in methods if not callable(getattr(self._opened, name, None))]
        if missing:
            raise UsageError(f"{self._owner} has no {', '.join(missing)}")
        self.calls = SlowCallMonitor(key)

    def call(self, name: str, *arguments: Any) -> Any:
        """Return what a method returns, unless it fails or is late."""
        begin_ns = now_ns()
        try:
            returned = getattr(self._opened, name)(*arguments)
        except Exception as error:
            raise ExtensionFault(
                f"{format_call_failure(self._key, name, error)}; {self._remedy}"
            ) from error
        elapsed_ns = now_ns() - begin_ns
        self.calls.add(elapsed_ns)
        if elapsed_ns > LATE_NS:
            took = f"took {elapsed_ns / 1e6:.0f} ms, must take below 1 ms, {LATE_NS / 1e6:g} ms at"
            raise self.build_fault(
                name, f"{took} most: let a thread compute, and return its newest"
            )
        return returned

    def check_tuple(self, name: str, returned: Any, kind: type[Any]) -> tuple[Any, ...]:
        """Return the fields of what a method returned, if it is a tuple of `kind`."""
        if not isinstance(returned, kind):
            what = type(returned).__name__
            raise self.build_fault(name, f"returned {what}, must be {kind.__name__}")
        return tuple(returned)

    def check(
        self, name: str, what: str, values: Any, count: int, limit: float, unit: str
    ) -> Array:
        """Return an array that a method returned, if it is `count` numbers of at most `limit`."""
        if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
            raise self.build_fault(
                name, f"{what} is a {type(values).__name__}, must be an array [{unit}]"
            )
        if values.shape != (count,):
            raise self.build_fault(
                name, f"{what} has shape {values.shape}, must be ({count},) [{unit}]"
            )
        # a copy, as the extension may change its own; plain, with what a mask hides; and floats, as
        # the smallest integer has no absolute value
        numbers = np.array(values, np.float64)
        peak = float(np.abs(numbers).max())
        if not math.isfinite(peak):
            raise self.build_fault(name, f"{what} is {numbers.tolist()}, not finite")
        if peak > limit:
            raise self.build_fault(name, f"{what} is {peak:g} {unit}, at most {limit:g} {unit}")
        return numbers

    def build_fault(self, name: str, text: str) -> ExtensionFault:
        """Return the fault of a method."""
        return ExtensionFault(f"{self._owner}.{name}: {text}; {self._remedy}")

    @property
    def _remedy(self) -> str:
        return f"correct it, or leave {self._key} out for the built-in one"
