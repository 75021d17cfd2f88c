"""The operator's end: a device with its encoder, and the hand that holds it.

A device is a mass with a damper to ground; its encoder has a resolution, and the force that it is
given is held for a tick. The hand is an arm's spring and damper that pull its mass, and the
device's with it, along a reference r(t),

    (m + m_d) x'' = k (r - x) + b (r' - x') - b_d x' + F

or it is infinitely firm, and the motion is given (`GuidedHand`). The numbers of hands are of the
order of those measured for a wrist and fingers that hold a stylus; they are nobody's in particular.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from scipy.linalg import expm

DT = 0.001  # [s] of a tick

Motion = Callable[[float], float]  # [m] at a time [s]


class HandModel(NamedTuple):
    """An arm."""

    mass: float = 0.3  # [kg]
    stiffness: float = 300.0  # [N/m]
    damping: float = 10.0  # [N s/m]


@dataclass(frozen=True, slots=True)
class Device:
    """A haptic device of one axis; by default an ideal one."""

    mass: float = 0.0  # [kg]
    damping: float = 0.0  # [N s/m]
    resolution: float = 0.0  # [m] of its encoder
    smoothing: float = 0.0  # [s] time constant of its velocity's filter, as in the HID drivers

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        for name, most, unit in (
            ("mass", 10.0, "kg"),
            ("damping", 1e3, "N s/m"),
            ("resolution", 0.01, "m"),
        ):
            if not 0.0 <= getattr(self, name) <= most:
                raise ValueError(f"{name}: must be 0 to {most:g} [{unit}]")
        if not 0.0 <= self.smoothing <= 0.1:
            raise ValueError("smoothing: must be within 0 ... 0.1 [s]")


USUAL, IDEAL = HandModel(), Device()


class Encoder:
    """Encoder and velocity filter of a device."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._last_position, self._velocity = math.nan, 0.0

    def read(self, position: float, velocity: float) -> tuple[float, float]:
        """Return the measured position [m] and velocity [m/s]; `velocity` is the true one."""
        step, smoothing = self._device.resolution, self._device.smoothing
        measured = round(position / step) * step if step > 0.0 else position
        if step == 0.0 and smoothing == 0.0:
            return measured, velocity
        way = measured - self._last_position if math.isfinite(self._last_position) else 0.0
        self._last_position = measured
        self._velocity = (smoothing * self._velocity + way) / (smoothing + DT)
        return measured, self._velocity


class Hand(Protocol):
    """Interface of a hand."""

    device: Device
    position: float  # [m]
    velocity: float  # [m/s]

    def advance(self, force: float) -> None:
        """Advance by a tick with the device's force `force` [N]."""


class Arm:
    """A hand that yields: its mass on its spring and damper, solved exactly over each tick.

    Parameters
    ----------
    reference : callable
        Where the arm wants to be [m], at a time [s]; straight within a tick.
    """

    def __init__(self, reference: Motion, model: HandModel = USUAL, device: Device = IDEAL) -> None:
        self.device = device
        self.position = self.velocity = 0.0
        self._reference, self._tick = reference, 0
        m, (_, k, b) = model.mass + device.mass, model
        # of x, v, and constant in a tick: the reference at its begin, its slope, the force
        flow = np.zeros((5, 5))
        flow[0, 1] = flow[2, 3] = 1.0
        flow[1] = np.array([-k, -b - device.damping, k, b, 1.0]) / m
        self._x, self._v = (row.tolist() for row in expm(flow * DT)[:2])

    def advance(self, force: float) -> None:
        """See `Hand`."""
        before, now = (self._reference(n * DT) for n in (self._tick, self._tick + 1))
        state = (self.position, self.velocity, before, (now - before) / DT, force)
        self.position = sum(c * s for c, s in zip(self._x, state, strict=True))
        self.velocity = sum(c * s for c, s in zip(self._v, state, strict=True))
        self._tick += 1


class GuidedHand:
    """A hand that no force moves off its way: `motion` [m] at a time [s], which must be smooth."""

    def __init__(self, motion: Motion, device: Device = IDEAL) -> None:
        self.device = device
        self._motion, self._tick = motion, 0
        self._go(0.0)

    def advance(self, _force: float) -> None:
        """See `Hand`."""
        self._tick += 1
        self._go(self._tick * DT)

    def _go(self, time: float) -> None:
        h = 1e-3 * DT
        self.position = self._motion(time)
        self.velocity = (self._motion(time + h) - self._motion(time - h)) / (2.0 * h)


def build_reach(target: float, begin: float, lasts: float = 0.6, back: float = math.inf) -> Motion:
    """Return a motion to `target` [m] that begins at `begin` [s], and returns at `back` [s]."""

    def move(time: float) -> float:
        return target * (
            _move_smoothly((time - begin) / lasts) - _move_smoothly((time - back) / lasts)
        )

    return move


def _move_smoothly(s: float) -> float:
    """Return the way of least jerk, 0 to 1 while s goes from 0 to 1."""
    s = min(max(s, 0.0), 1.0)
    return s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
