"""Base class of the configs of rigs in other packages."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from estimator.array_types import Array
from slave.rig import Rig, RigFault, RigFinished, RigSample
from teleop.config.extensions import Extension, close_extension, format_call_failure
from teleop.runtime.process import print_warning

# --- what a rig of another package returns, checked before the loop takes it

_ARRAYS = (
    "proximal_tension",
    "proximal_displacement",
    "bench_distal_tension",
    "bench_distal_displacement",
    "loop_moved_tension",
    "loop_held_tension",
)
_REQUIRED = (
    *("name", "tendons", "joints", "starts_at_zero"),
    *("read", "write", "advance", "summarise", "close"),
)
_OPTIONAL = ("follows", "emergency_stop", "announce_pause")


class CheckedRig:
    """A `slave.rig.Rig` of another package whose mistakes are a `RigFault` that names them.

    A reading that is not finite is no mistake: it is missing, which the estimator handles. What
    else the rig has, as `follows` or `emergency_stop`, is passed on; where its code fails to give
    it, that is a `RigFault` too, never taken for its absence. Of `summarise` and `close`, which
    come last, a failure is a warning: it must not replace what ended the session.

    The rig is open; messages call it `place`. `RigFault` if it lacks an attribute or a method, one
    is of another type, or `follows` fails.
    """

    def __init__(self, rig: Rig, place: str) -> None:
        owner = f"{place}: {type(rig).__name__}"
        missing = [name for name in _REQUIRED if not hasattr(rig, name)]
        if missing:
            raise RigFault(f"{owner} has no {', '.join(missing)}")
        if not isinstance(rig.name, str) or not isinstance(rig.tendons, int):
            raise RigFault(f"{owner}: name must be a text, tendons a number")
        try:
            joints = tuple(tuple(int(tendon) for tendon in joint) for joint in rig.joints)
        except (TypeError, ValueError) as error:
            raise RigFault(f"{owner}: joints {rig.joints}, must be as in ((0, 1), (2,))") from error
        self._rig, self._place = rig, place
        self.name, self.tendons, self.joints = rig.name, rig.tendons, joints
        self.starts_at_zero = rig.starts_at_zero
        self._shape = (rig.tendons,)
        self._newest_s = -math.inf
        for name in _OPTIONAL:
            getattr(self, name, None)  # a fault of the loop otherwise

    def __getattr__(self, name: str) -> Any:
        rig = self._rig
        try:
            value = getattr(rig, name)
        except (RigFault, RigFinished):
            raise
        except Exception as error:
            # raised in a property of the rig, it would be taken for a rig without that attribute
            if isinstance(error, AttributeError) and not hasattr(type(rig), name):
                raise
            owner = f"{type(rig).__name__}.{name}"
            raise RigFault(format_call_failure(self._place, owner, error)) from error
        if name == "follows":
            if not isinstance(value, bool | np.bool_):
                owner = f"{self._place}: {type(rig).__name__}.{name}"
                raise RigFault(f"{owner} is {_format_type(value)}, must be True or False")
            return bool(value)
        return partial(self._call, value) if callable(value) else value

    def read(self, time_s: float) -> tuple[RigSample, ...]:
        """Return the rig's new samples; `RigFault` if one is not as `slave.rig.RigSample` says."""
        samples = self._call(self._rig.read, time_s)
        if samples.__class__ is not tuple:
            if not isinstance(samples, list):
                raise self._build_fault(
                    f"returned {_format_type(samples)}, must be a tuple of RigSample"
                )
            samples = tuple(samples)
        for sample in samples:
            self._check(sample)
        checked: tuple[RigSample, ...] = samples
        return checked

    def write(self, proximal_displacement: Array) -> None:
        """Write motor positions [m]."""
        self._call(self._rig.write, proximal_displacement)

    def advance(self) -> RigSample | None:
        """Let the rig do its work that is not time-critical."""
        sample: RigSample | None = self._call(self._rig.advance)
        if sample is not None:
            self._check(sample)
        return sample

    def summarise(self) -> dict[str, int | float | str]:
        """Return the rig's entries for the run summary; `error` if they are not as they must be."""
        try:
            entries: dict[str, int | float | str] = {
                key: value.item() if isinstance(value, np.generic) else value
                for key, value in self._rig.summarise().items()
            }
            json.dumps(entries)
        except Exception as error:
            failure = format_call_failure(self._place, "summarise", error)
            print_warning(failure)
            return {"error": failure}
        return entries

    def close(self) -> None:
        """Close the rig; a failure is a warning."""
        close_extension(self._place, self._rig)

    def _call(self, method: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return method(*arguments)
        except (RigFault, RigFinished):
            raise
        except Exception as error:
            raise RigFault(format_call_failure(self._place, _name_of(method), error)) from error

    def _check(self, sample: RigSample) -> None:
        """Raise `RigFault` unless a sample has one number a tendon, at a time that does not fall.

        In 0.6 us (1 us with a bench); what is wrong is found out only once something is.
        """
        try:
            tension, travel = sample.proximal_tension, sample.proximal_displacement
            tip_tension, tip_travel = sample.bench_distal_tension, sample.bench_distal_displacement
            moved, held = sample.loop_moved_tension, sample.loop_held_tension
            shape = self._shape
            is_right = (
                tension.shape == shape
                and tension.dtype.kind in "fiu"
                and (travel is None or (travel.shape == shape and travel.dtype.kind in "fiu"))
                and (tip_tension is None or _is_right(tip_tension, shape))
                and (tip_travel is None or _is_right(tip_travel, shape))
                and (moved is None or _is_right(moved, shape))
                and (held is None or _is_right(held, shape))
                and self._newest_s <= sample.time_s < math.inf
            )
        except (AttributeError, TypeError):
            is_right = False
        if not is_right:
            raise self._build_fault(self._build_mistake(sample))
        self._newest_s = sample.time_s

    def _build_mistake(self, sample: Any) -> str:
        """Return what is wrong with a sample."""
        if not isinstance(sample, RigSample):
            return f"returned {_format_type(sample)}, must be RigSample"
        for name in _ARRAYS:
            values = getattr(sample, name)
            if values is None and name != "proximal_tension":
                continue
            if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
                return f"{name} is {_format_type(values)}, must be an array of numbers"
            if values.shape != self._shape:
                return f"{name} has shape {values.shape}, must be {self._shape}, one a tendon"
        return f"time_s is {sample.time_s} after {self._newest_s}, must increase [s]"

    def _build_fault(self, text: str) -> RigFault:
        return RigFault(f"{self._place}: {type(self._rig).__name__}.read: {text}")


def _is_right(values: Array, shape: tuple[int]) -> bool:
    return values.shape == shape and values.dtype.kind in "fiu"


def _name_of(method: Callable[..., Any]) -> str:
    return str(getattr(method, "__name__", type(method).__name__))


def _format_type(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype}"
    return "None" if value is None else f"a {type(value).__name__}"


@dataclass(frozen=True)
class RigExtension(Extension):
    """Base of the configs of rigs of other packages (docs/how-to/rigs.md)."""

    GROUP: ClassVar[str] = "teleop.rigs"

    def open(self) -> Rig:
        """Open the rig that this config describes; raises `slave.rig.RigFault` on failure."""
        raise NotImplementedError

    def open_read_only(self) -> Rig:
        """Open the rig so that nothing is written to its hardware, and no motor is enabled.

        For `teleop rig check --read-only`; a rig that supports it overrides this. Never written to.
        """
        raise RigFault(
            f"{self.type}: does not support --read-only; its config class would have open_read_only"
        )
