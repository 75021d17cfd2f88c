"""A rig of real motors and load cells, on one bus or on two."""

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from estimator.array_types import Array
from slave.drivers.connection import DriverProcess
from slave.drivers.driver import BusReading, Channels, Counts, DriverFault
from slave.drivers.driver_table import DriverConfig
from slave.drivers.dynamixel.config import DynamixelConfig
from slave.rig import RigFault, RigSample, number_joint_tendons
from teleop.config.ranges import RangedConfig, build_ranged_field, check_ranges
from teleop.messages.messages import MAX_JOINTS

# --- motor positions and tensions that were sampled at different times, as samples of one time

READINGS_KEPT = 64  # readings of each kind
SMOOTHING = 0.1  # of the mean period


class Aligner:
    """Resamples readings of two buses at the times of the slower one.

    Each reading of the slower bus becomes one sample; the values of the faster are interpolated
    linearly between the readings before and after. A sample waits for the reading after, at most
    one period of the faster bus. Nothing is extrapolated. `worst_s` is the largest distance [s] of
    a sample from the nearer of the two readings it was interpolated between: the bound of the
    alignment error in time.
    """

    def __init__(self) -> None:
        self.worst_s = 0.0
        self._motors = _ReadingStream(lambda reading: reading.position)
        self._cells = _ReadingStream(lambda reading: reading.cell)
        self._last_s = -math.inf

    def align(
        self, motors: Iterable[BusReading], cells: Iterable[BusReading]
    ) -> Iterator[tuple[float, Counts, Counts]]:
        """Yield the new samples, oldest first: time [s], motor positions, cells in counts.

        The new readings of both come oldest first.
        """
        self._motors.extend(motors)
        self._cells.extend(cells)
        by_cells = self._cells.period_s >= self._motors.period_s
        slow, fast = (self._cells, self._motors) if by_cells else (self._motors, self._cells)
        for time_s, value in slow.take_until(fast.newest_s):
            interpolated = fast.interpolate(time_s) if time_s > self._last_s else None
            if interpolated is None:
                continue
            fast_values, distance_s = interpolated
            self._last_s = time_s
            self.worst_s = max(self.worst_s, distance_s)
            yield (time_s, fast_values, value) if by_cells else (time_s, value, fast_values)
        for _ in fast.take_until(self._last_s):  # none of them waits any longer
            pass


class _ReadingStream:
    """Readings of one bus, of which `select` takes the values in use."""

    def __init__(self, select: Callable[[BusReading], Counts]) -> None:
        self.newest_s = -math.inf
        self.period_s = math.nan  # mean; comparisons with an unknown one fail
        self._select = select
        self._kept: deque[tuple[float, Counts]] = deque(maxlen=READINGS_KEPT)
        self._waiting: deque[tuple[float, Counts]] = deque(maxlen=READINGS_KEPT)

    def extend(self, readings: Iterable[BusReading]) -> None:
        """Add readings; those that are not newer than the last are dropped."""
        for reading in readings:
            elapsed = reading.time_s - self.newest_s
            if elapsed <= 0.0:
                continue
            if math.isfinite(elapsed):
                has_period = math.isfinite(self.period_s)
                change = elapsed - self.period_s if has_period else 0.0
                self.period_s = (self.period_s if has_period else elapsed) + SMOOTHING * change
            self.newest_s = reading.time_s
            entry = (reading.time_s, self._select(reading))
            self._kept.append(entry)
            self._waiting.append(entry)

    def take_until(self, time_s: float) -> Iterator[tuple[float, Counts]]:
        """Take the waiting readings up to a time."""
        while self._waiting and self._waiting[0][0] <= time_s:
            yield self._waiting.popleft()

    def interpolate(self, time_s: float) -> tuple[Counts, float] | None:
        """Return the values at a time, and its distance [s] to the nearer reading."""
        for (t0, a), (t1, b) in pairwise(self._kept):
            if t0 <= time_s <= t1:
                share = (time_s - t0) / (t1 - t0)
                return a + share * (b - a), min(time_s - t0, t1 - time_s)
        return None


AGE_MAX_S = 0.1  # older readings, behind a stall of the loop, are not used
STEP_MAX = 0.002  # [m] from where a motor is to its target, before it follows


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorConfig(RangedConfig):
    """A motor and the pulley that winds its tendon."""

    id: int  # on its bus
    # of the pulley that winds the tendon
    pulley_radius: float = build_ranged_field(..., 1e-4, 1.0, "m")
    counts_per_turn: float = build_ranged_field(..., 1.0, 1e9)  # of the motor's shaft
    gear: float = build_ranged_field(1.0, 1e-3, 1e5)  # turns of the motor a turn of the pulley
    direction: Literal[1, -1] = 1  # 1: counts grow as the tendon is pulled in
    zero: float = 0.0  # [counts] where the tendon's displacement is 0

    @property
    def metres_per_count(self) -> float:
        """Displacement of the tendon [m] a count, with its sign."""
        turn = 2.0 * math.pi * self.pulley_radius
        return self.direction * turn / (self.gear * self.counts_per_turn)


@dataclass(frozen=True, slots=True, kw_only=True)
class CellConfig:
    """A load cell at the housing, or a motor current in its place."""

    id: int  # on its bus
    scale: float  # [N/count], of either sign
    offset: float = 0.0  # [counts] without load
    # standard; required where a current is read
    uncertainty: float | None = build_ranged_field(None, 0.0, math.inf, "N", above=True)

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.scale == 0.0:
            raise ValueError("scale: must not be 0 [N/count]")


@dataclass(frozen=True, slots=True)
class HardwareTendonConfig:
    """One tendon: its motor and its load cell."""

    motor: MotorConfig
    cell: CellConfig
    loop: tuple[CellConfig, ...] = ()  # of a sensing loop in its tube: moved end, held end

    def __post_init__(self) -> None:
        """Check the number of cells; raises `ValueError`."""
        if len(self.loop) not in (0, 2):
            raise ValueError("loop: must have no cell or two")
        if self.loop and len({self.cell.id, *(cell.id for cell in self.loop)}) < 3:
            raise ValueError("loop: both cells must have ids of their own")


@dataclass(frozen=True, slots=True)
class HardwareJointConfig:
    """One joint, pulled by one tendon against a spring or by two against each other."""

    tendons: tuple[HardwareTendonConfig, ...]  # a, or a and b

    def __post_init__(self) -> None:
        """Check the number of tendons; raises `ValueError`."""
        if len(self.tendons) not in (1, 2):
            raise ValueError("tendons: must be 1 or 2")


@dataclass(frozen=True, slots=True, kw_only=True)
class HardwareRigConfig:
    """Real motors and load cells: buses, and what each tendon has on them."""

    type: Literal["hardware"] = "hardware"
    name: str  # of the rig in calibration files
    motors: DriverConfig  # bus of the motors, and of the load cells without `cells`
    cells: DriverConfig | None = None  # bus of the load cells, if not that of the motors
    joints: tuple[HardwareJointConfig, ...]  # their tendons: a, or a and b

    def __post_init__(self) -> None:
        """Check joints and addresses; raises `ValueError`."""
        if not self.name.strip():
            raise ValueError("name: must not be empty")
        if not 1 <= len(self.joints) <= MAX_JOINTS:
            raise ValueError(f"joints: must be 1 to {MAX_JOINTS}")
        for kind, ids in (
            ("motor", [t.motor.id for t in self.tendons]),
            ("cell", list(self.cell_ids)),
        ):
            bus = self.motors if kind == "motor" or self.cells is None else self.cells
            for number in ids:
                if number not in bus.NUMBERS or number == getattr(bus, "master", None):
                    raise ValueError(
                        f"joints: {kind} {number}: must be {bus.NUMBERS[0]} to {bus.NUMBERS[-1]} "
                        f"on {bus.type}{', and not its master' * hasattr(bus, 'master')}"
                    )
                if ids.count(number) > 1:
                    raise ValueError(f"joints: {kind} {number} belongs to two tendons")
        reads_currents = isinstance(self.cells or self.motors, DynamixelConfig)
        if reads_currents and any(c.uncertainty is None for c in list_cells(self.tendons)):
            raise ValueError(
                "joints: tensions from motor currents need the uncertainty [N] of each cell, those "
                "of loops too, or load cells on a bus of their own (cells)"
            )

    @property
    def tendons(self) -> tuple[HardwareTendonConfig, ...]:
        """All tendons, joint after joint."""
        return tuple(tendon for joint in self.joints for tendon in joint.tendons)

    @property
    def motor_ids(self) -> tuple[int, ...]:
        """Motors in the order of the tendons."""
        return tuple(tendon.motor.id for tendon in self.tendons)

    @property
    def cell_ids(self) -> tuple[int, ...]:
        """Load cells in the order of the tendons, then those of the sensing loops."""
        return tuple(cell.id for cell in list_cells(self.tendons))


def list_cells(tendons: Sequence[HardwareTendonConfig]) -> list[CellConfig]:
    """Return the load cells of tendons, then those of their loops; two may share a loop."""
    return [t.cell for t in tendons] + list(dict.fromkeys(c for t in tendons for c in t.loop))


class Transmission:
    """Counts of the buses as tensions [N] and displacements [m], and back."""

    def __init__(self, tendons: Sequence[HardwareTendonConfig]) -> None:
        motors, cells = [t.motor for t in tendons], list_cells(tendons)
        self._metres = np.array([motor.metres_per_count for motor in motors])
        self._zero = np.array([motor.zero for motor in motors])
        self._newtons = np.array([cell.scale for cell in cells])
        self._offset = np.array([cell.offset for cell in cells])

    def to_displacement(self, position: Counts) -> Array:
        """Return the tendons' displacements [m] of motor positions."""
        metres: Array = (position - self._zero) * self._metres
        return metres

    def to_tension(self, cell: Counts) -> Array:
        """Return the tensions [N] of cell readings."""
        newtons: Array = (cell - self._offset) * self._newtons
        return newtons

    def to_counts(self, displacement: Array) -> Counts:
        """Return the motor positions of displacements [m]."""
        counts: Counts = displacement / self._metres + self._zero
        return counts


class HardwareRig:
    """A `slave.rig.Rig` whose drivers run in processes of their own.

    `read` hands over what they have received since, each sample once; `write` leaves the newest
    targets with them. Any failure of a driver is a `RigFault` with the driver's own words; its
    motors are then stopped already. With `read_only` nothing is written to the buses, and targets
    are not obeyed. It is an `EnablingRig`, a `StoppableRig` and a `WatchedRig` of
    `slave.rig`.
    """

    starts_at_zero = False

    def __init__(self, config: HardwareRigConfig, read_only: bool = False) -> None:
        self.name = config.name
        self.joints = number_joint_tendons([len(joint.tendons) for joint in config.joints])
        self.tendons = len(config.tendons)
        self._transmission = Transmission(config.tendons)
        listed = list_cells(config.tendons)
        self._loops = [[listed.index(cell) for cell in t.loop] for t in config.tendons]
        self._aligner = Aligner() if config.cells is not None else None
        self.buses: list[DriverProcess] = []  # of the motors, and of the cells if that is another
        self._position: Array | None = None  # [m] newest of every motor
        self._position_s = 0.0  # when it was sampled
        # newest positions and cell readings, as they came from the buses
        self.counts: tuple[Counts, Counts] | None = None
        self.follows = False
        self._enabled = False  # whether the motors were given targets, and no stop since
        self._target: Counts = np.empty(0)  # newest
        self._written = False  # whether since the last read
        self._late = self._samples = 0
        self._start_s = time.monotonic()
        motors, cells = config.motor_ids, config.cell_ids
        try:
            if config.cells is None:
                self.buses = [DriverProcess(config.motors, Channels(motors, cells, read_only))]
            else:
                self.buses.append(DriverProcess(config.motors, Channels(motors, (), read_only)))
                self.buses.append(DriverProcess(config.cells, Channels((), cells, read_only)))
        except DriverFault as fault:
            self.close()
            raise RigFault(str(fault)) from fault

    def read(self, time_s: float) -> tuple[RigSample, ...]:  # noqa: ARG002 - the rig's own clock
        """Return the samples received since the last call."""
        oldest_s = time.monotonic() - AGE_MAX_S
        samples = []
        for sampled_s, position, cell in self._take_reading():
            if sampled_s < oldest_s:
                self._late += 1
                continue
            displacement = self._transmission.to_displacement(position)
            tension = self._transmission.to_tension(cell)
            loops = self._read_loops(tension)
            housing = sampled_s - self._start_s, tension[: self.tendons], displacement
            samples.append(RigSample(*housing, None, None, *loops))
            self.counts = (position, cell)
            if np.all(np.isfinite(displacement)):
                self._position, self._position_s = displacement, sampled_s
        self._samples += len(samples)
        if self._enabled and not self._written:
            self._order(DriverProcess.write, self._target)  # a loop that reads does not hang
        self._written = False
        return tuple(samples)

    def write(self, proximal_displacement: Array) -> None:
        """Leave targets [m] with the driver; until they follow, where the motors are."""
        if proximal_displacement.shape != (self.tendons,) or not np.all(
            np.isfinite(proximal_displacement)
        ):
            raise RigFault(f"invalid motor targets {proximal_displacement.tolist()}")
        if not self.follows:
            self._require_near(proximal_displacement)
            self._enabled = True
        self._target, self._written = self._transmission.to_counts(proximal_displacement), True
        self._order(DriverProcess.write, self._target)

    def announce_pause(self) -> None:
        """Have the driver hold the newest targets through one pause of the loop."""
        self._order(DriverProcess.announce_pause)

    def emergency_stop(self) -> None:
        """Stop the motors by their own means; the next `write` enables them again."""
        self.follows = self._enabled = False
        self._order(DriverProcess.stop)

    def advance(self) -> None:
        """Do nothing: the drivers have processes of their own."""

    def summarise(self) -> dict[str, int | float | str]:
        """Return samples, those too old to be used, the alignment error and the drivers' counts."""
        figures: dict[str, int | float | str] = {"samples": self._samples, "late": self._late}
        if self._aligner is not None:
            figures["alignment_error_ms"] = round(self._aligner.worst_s * 1e3, 3)
        for name, bus in zip(("motors", "cells"), self.buses, strict=False):
            figures |= {f"{name}_{key}": value for key, value in bus.counts.items()}
        return figures

    def close(self) -> None:
        """Let the drivers stop their motors and release their buses."""
        for bus in self.buses:
            bus.close()

    def _read_loops(self, tension: Array) -> Sequence[Array | None]:
        """Return the tensions [N] at the moved and the held ends of the sensing loops."""
        if not any(self._loops):
            return None, None
        ends = [tension[loop] if loop else (math.nan, math.nan) for loop in self._loops]
        return tuple(np.array(ends).T)

    def _order(self, method: Callable[..., None], *arguments: Counts) -> None:
        """Call a method of the motors' driver."""
        try:
            method(self.buses[0], *arguments)
        except DriverFault as fault:
            raise RigFault(str(fault)) from fault

    def _take_reading(self) -> Sequence[tuple[float, Counts, Counts]]:
        try:
            readings = [bus.read() for bus in self.buses]
        except DriverFault as fault:
            raise RigFault(str(fault)) from fault
        if readings[0]:
            self.follows = self._enabled and readings[0][-1].follows
        if self._aligner is None:
            return [(r.time_s, r.position, r.cell) for r in readings[0]]
        return list(self._aligner.align(*readings))

    def _require_near(self, target: Array) -> None:
        """Refuse targets that would make a motor jump as it is enabled."""
        if self._position is None:
            raise RigFault("no position of every motor is known, so none is enabled")
        age_s = time.monotonic() - self._position_s
        if not self._enabled and age_s > AGE_MAX_S:
            raise RigFault(
                f"the newest positions are {age_s * 1e3:.0f} ms old, {AGE_MAX_S * 1e3:g} ms at "
                "most, so no motor is enabled"
            )
        distance = np.abs(target - self._position)
        motor = int(np.argmax(distance))
        if distance[motor] > STEP_MAX:
            raise RigFault(
                f"the first target of tendon {motor + 1} is {distance[motor] * 1e3:.1f} mm from "
                f"where its motor is, {STEP_MAX * 1e3:g} mm at most"
            )
