"""What a rig of another package returns, checked before the loop takes it."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from estimator.array_types import Array
from slave.rig import Rig, RigFault, RigFinished, RigSample
from teleop.extensions import call_failed

_ARRAYS = (
    "proximal_tension",
    "proximal_displacement",
    "bench_distal_tension",
    "bench_distal_displacement",
)
_REQUIRED = (
    *("name", "tendons", "joints", "starts_at_zero"),
    *("read", "write", "advance", "summary", "close"),
)


class CheckedRig:
    """A `slave.rig.Rig` of another package whose mistakes are a `RigFault` that names them.

    A reading that is not finite is no mistake: it is missing, which the estimator handles. What
    else the rig has, as `follows` or `emergency_stop`, is passed on.

    Parameters
    ----------
    rig : Rig
        Open.
    place : str
        Name of the rig in messages.

    Raises
    ------
    RigFault
        It lacks an attribute or a method, or one is of another type.
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

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._rig, name)
        return partial(self._call, value) if callable(value) else value

    def read(self, time_s: float) -> tuple[RigSample, ...]:
        """Return the rig's new samples; `RigFault` if one is not as `slave.rig.RigSample` says."""
        samples = self._call(self._rig.read, time_s)
        if samples.__class__ is not tuple:
            if not isinstance(samples, list):
                raise self._fault(f"returned {_kind(samples)}, must be a tuple of RigSample")
            samples = tuple(samples)
        for sample in samples:
            self._check(sample)
        found: tuple[RigSample, ...] = samples
        return found

    def write(self, proximal_displacement: Array) -> None:
        """Write motor positions [m]."""
        self._call(self._rig.write, proximal_displacement)

    def advance(self) -> RigSample | None:
        """Let the rig do its work that is not time-critical."""
        sample: RigSample | None = self._call(self._rig.advance)
        if sample is not None:
            self._check(sample)
        return sample

    def summary(self) -> dict[str, int | float | str]:
        """Return the rig's entries for the run summary."""
        return self._rig.summary()

    def close(self) -> None:
        """Close the rig."""
        self._rig.close()

    def _call(self, method: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return method(*arguments)
        except (RigFault, RigFinished):
            raise
        except Exception as error:
            raise RigFault(call_failed(self._place, method.__name__, error)) from error

    def _check(self, sample: RigSample) -> None:
        """Raise `RigFault` unless a sample has one number a tendon, at a time that does not fall.

        In 0.5 us; what is wrong is found out only once something is.
        """
        try:
            tension, travel = sample.proximal_tension, sample.proximal_displacement
            tip_tension, tip_travel = sample.bench_distal_tension, sample.bench_distal_displacement
            shape = self._shape
            is_right = (
                tension.shape == shape
                and (travel is None or travel.shape == shape)
                and (tip_tension is None or tip_tension.shape == shape)
                and (tip_travel is None or tip_travel.shape == shape)
                and tension.dtype.kind in "fiu"
                and self._newest_s <= sample.time_s < math.inf
            )
        except (AttributeError, TypeError):
            is_right = False
        if not is_right:
            raise self._fault(self._mistake(sample))
        self._newest_s = sample.time_s

    def _mistake(self, sample: Any) -> str:
        """Return what is wrong with a sample."""
        if not isinstance(sample, RigSample):
            return f"returned {_kind(sample)}, must be RigSample"
        for name in _ARRAYS:
            values = getattr(sample, name)
            if values is None and name != "proximal_tension":
                continue
            if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
                return f"{name} is {_kind(values)}, must be an array of numbers"
            if values.shape != self._shape:
                return f"{name} has shape {values.shape}, must be {self._shape}, one a tendon"
        return f"time_s is {sample.time_s} after {self._newest_s}, must increase [s]"

    def _fault(self, text: str) -> RigFault:
        return RigFault(f"{self._place}: {type(self._rig).__name__}.read: {text}")


def _kind(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype}"
    return "None" if value is None else f"a {type(value).__name__}"
