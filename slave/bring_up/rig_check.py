"""Check of a rig: what it measures at rest, and how each motor moves at low force."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.structs import to_struct
from slave import gate
from slave.calibration.procedure_run import (
    NO_READINGS_TEXT,
    SILENCE_MAX_S,
    WARM_UP_HZ,
    StationaryRig,
    generate_fast_ticks,
    is_complete,
)
from slave.gate import GateConfig
from slave.rig import Rig, RigSample, has_following_motors
from teleop.errors import TeleopError
from teleop.runtime.clock import Tick

SAMPLES_MIN = 10  # samples


@dataclass(frozen=True)
class RestMeasurement:
    """Samples of a rig at rest: rates, means and noise of each tendon."""

    rate_hz: float
    longest_gap_s: float
    displacement: Array  # [m] shape (tendons,)
    displacement_noise: Array  # [m] standard deviation
    tension: Array  # [N]
    tension_noise: Array  # [N]


def measure_at_rest(
    rig: Rig, ticks: Iterable[Tick], start_ns: int, duration_s: float
) -> RestMeasurement:
    """Read for a while, move nothing; `TeleopError` if there are too few samples."""
    samples: list[RigSample] = []
    began_ns = None
    for tick in ticks:
        began_ns = tick.stamp_ns if began_ns is None else began_ns
        samples += rig.read((tick.stamp_ns - start_ns) * 1e-9)
        rig.advance()
        if (tick.stamp_ns - began_ns) * 1e-9 >= duration_s:
            break
    if len(samples) < SAMPLES_MIN:
        raise TeleopError(f"rig: {len(samples)} samples in {duration_s:g} s: check its sensors")
    return compute_rest_measurement(samples)


def compute_rest_measurement(samples: Sequence[RigSample]) -> RestMeasurement:
    """Return what samples of a rig at rest say."""
    times = np.array([sample.time_s for sample in samples])
    tension = np.array([sample.proximal_tension for sample in samples])
    displacement = np.array([get_displacement(sample) for sample in samples])
    return RestMeasurement(
        rate_hz=float((len(times) - 1) / (times[-1] - times[0])),
        longest_gap_s=float(np.diff(times).max()),
        displacement=displacement.mean(axis=0),
        displacement_noise=displacement.std(axis=0),
        tension=tension.mean(axis=0),
        tension_noise=tension.std(axis=0),
    )


def find_outside(rest: RestMeasurement, limits: GateConfig) -> list[int]:
    """Return the tendons, from 0, at a displacement that the gate passes to no motor."""
    low, high = limits.displacement_min, limits.displacement_max
    return [k for k, travel in enumerate(rest.displacement) if travel < low or travel > high]


def format_rest_measurement(rest: RestMeasurement, limits: GateConfig) -> list[str]:
    """Return the measurement as lines, with what is suspicious in it."""
    outside = find_outside(rest, limits)
    lines = [
        f"samples: {rest.rate_hz:.0f} Hz, longest gap {rest.longest_gap_s * 1e3:.1f} ms",
        f"{'tendon':>6} {'tension N':>18} {'displacement mm':>20}",
    ]
    for k, tension in enumerate(rest.tension):
        lines.append(
            f"{k + 1:>6} {tension:>10.3f}±{rest.tension_noise[k]:<7.3f} "
            f"{rest.displacement[k] * 1e3:>11.4f}±{rest.displacement_noise[k] * 1e3:<8.4f}"
        )
        if not np.isfinite(tension) or not np.isfinite(rest.displacement[k]):
            lines.append("       no reading: check the cell's and the motor's number in the config")
        elif rest.tension_noise[k] == 0.0:
            lines.append("       its tension does not vary at all: is the cell connected?")
        elif tension < -5.0 * rest.tension_noise[k]:
            lines.append("       its tension is negative: cell.offset, or the sign of cell.scale")
        if k in outside:
            low, high = limits.displacement_min * 1e3, limits.displacement_max * 1e3
            lines.append(
                f"       it is outside slave.gate ({low:g} to {high:g} mm): has its motor lost "
                "turns since `zero` was read? Unwind it, or read motor.zero anew"
            )
    return lines


def get_displacement(sample: RigSample) -> Array:
    """Return the displacements [m] of a sample; NaN without encoders."""
    if sample.proximal_displacement is None:
        return np.full(len(sample.proximal_tension), np.nan)
    return sample.proximal_displacement


# --- second part: one motor after the other is moved a little, at low force
# Every position has passed `slave.gate`. The motors are enabled where they are; then one pulls in
# by the stated travel, holds, and returns; it pulls no further once the tension has risen by the
# stated force.


SPEED = 0.002  # [m/s]
HOLD_S = 0.5  # [s] of which the second half is averaged
HOLD_BEFORE_S = 0.5  # [s] in which they hold before one moves
SIGNIFICANCE = 5.0  # standard deviations of the noise
TRAVEL_ERROR = 0.1  # relative, of the travel


class MotorMove(NamedTuple):
    """How far and how strongly a motor is moved."""

    travel: float  # [m]
    force: float  # [N] above the tension at rest


class MoveResult(NamedTuple):
    """One motor's answer."""

    tendon: int  # from 0
    commanded: float  # [m] that it was really moved
    travel: float  # [m] measured
    tension: Array  # [N] change of every tendon, shape (tendons,)


def move_motor(
    mover: "GatedRig", rest: RestMeasurement, tendon: int, move: MotorMove
) -> MoveResult:
    """Move one motor and back; the others hold."""
    mover.run(HOLD_BEFORE_S, mover.last)
    top = mover.pull(tendon, move)
    mover.run(HOLD_S / 2.0, mover.last)
    samples = mover.run(HOLD_S / 2.0, mover.last)
    travel, tension = _average_samples(samples)
    mover.pull(tendon, MotorMove(-top, np.inf))
    mover.run(HOLD_S / 2.0, mover.last)
    return MoveResult(
        tendon, top, float(travel[tendon] - rest.displacement[tendon]), tension - rest.tension
    )


def warm_up() -> None:
    """Compile what a tick of a `GatedRig` calls, before a rig's readings grow old meanwhile."""
    rig, ticks = StationaryRig(), generate_fast_ticks(WARM_UP_HZ)
    rest = measure_at_rest(rig, ticks, 0, HOLD_BEFORE_S)
    mover = GatedRig(rig, GateConfig(), ticks, 0, rest)
    mover.enable()
    mover.run(HOLD_S, mover.last)


class GatedRig:
    """A rig whose motors are moved through the gate, from where they were `rest`ing just now."""

    def __init__(
        self,
        rig: Rig,
        limits: GateConfig,
        ticks: Iterable[Tick],
        start_ns: int,
        rest: RestMeasurement,
    ) -> None:
        self.last = rest.displacement
        self._rig, self._gate, self._start_ns = rig, to_struct(limits), start_ns
        self._ticks = iter(ticks)
        self._tension, self._silence = rest.tension, 0.0

    def enable(self) -> None:
        """Write where the motors are, from a reading of the same tick on, until they follow."""
        is_located = False
        while True:
            dt, samples = self._read()
            for sample in samples:
                if is_complete(sample):
                    self.last, is_located = get_displacement(sample), True
            if is_located and has_following_motors(self._rig):
                return
            if is_located:
                self._write(self.last, dt)
            elif self._silence > SILENCE_MAX_S:
                raise TeleopError(f"rig: {NO_READINGS_TEXT}")

    def run(self, duration_s: float, target: Array) -> list[RigSample]:
        """Ask for a position for a while; return the samples."""
        samples: list[RigSample] = []
        while duration_s > 0.0:
            dt, new = self._tick(target)
            duration_s -= dt
            samples += new
        return samples

    def pull(self, tendon: int, move: MotorMove) -> float:
        """Move a motor by a travel, or until its tension has risen; return by how much."""
        begin, limit = self.last[tendon], self._tension[tendon] + move.force
        setpoint, target = self.last.copy(), self.last[tendon] + move.travel
        sign = 1.0 if move.travel > 0.0 else -1.0
        while sign * (target - setpoint[tendon]) > 0.0:
            if sign > 0.0 and not self._tension[tendon] <= limit:  # nor if it is not known
                break
            dt, _ = self._tick(setpoint)
            setpoint[tendon] += sign * min(SPEED * dt, abs(target - setpoint[tendon]))
        self._tick(setpoint)
        return float(self.last[tendon] - begin)

    def _tick(self, target: Array) -> tuple[float, list[RigSample]]:
        dt, samples = self._read()
        self._write(target, dt)
        return dt, samples

    def _read(self) -> tuple[float, list[RigSample]]:
        """Wait for the next tick; return the time since the last one [s] and the new samples."""
        tick = next(self._ticks)
        samples = list(self._rig.read((tick.stamp_ns - self._start_ns) * 1e-9))
        self._silence += tick.dt
        if samples:
            self._tension, self._silence = samples[-1].proximal_tension, 0.0
        return tick.dt, samples

    def _write(self, target: Array, dt: float) -> None:
        """Pass positions [m] through the gate and write them."""
        self.last, _ = gate.limit_targets(
            self._gate, self.last, target, self._tension, self._silence, dt
        )
        self._rig.write(self.last.copy())
        self._rig.advance()


def evaluate_move(result: MoveResult, rest: RestMeasurement) -> tuple[bool, str]:
    """Return whether a motor has answered as it should, and what it did."""
    k, name = result.tendon, f"tendon {result.tendon + 1}"
    did = f"{name}: moved {result.travel * 1e3:+.2f} of {result.commanded * 1e3:+.2f} mm, "
    did += f"tension {result.tension[k]:+.2f} N"
    noise = np.maximum(rest.tension_noise, 1e-3)
    answers = result.tension / noise
    if abs(result.travel - result.commanded) > TRAVEL_ERROR * abs(result.commanded):
        return False, f"{did}: the motor does not follow: power, limits, motor.counts_per_turn?"
    if answers[k] > SIGNIFICANCE:
        others = np.where(np.arange(len(answers)) == k, 0.0, np.abs(answers))
        other = int(np.argmax(others))
        if others[other] <= SIGNIFICANCE:
            return True, f"{did}: right"
        share = result.tension[other] / result.tension[k]
        return True, (
            f"{did}: right; the cell of tendon {other + 1} follows by {share:+.0%}: through their "
            "joint, or, if they have none in common, by cross-talk (converter switched too early?)"
        )
    if answers[k] < -SIGNIFICANCE:
        return False, f"{did}: the tension falls: motor.direction, or the sign of cell.scale"
    strongest = int(np.argmax(answers))
    if answers[strongest] > SIGNIFICANCE:
        return False, f"{did}: the cell of tendon {strongest + 1} answers in its place"
    return False, f"{did}: no tension: a slack tendon, or a cell that is not on it"


def _average_samples(samples: list[RigSample]) -> tuple[Array, Array]:
    return (
        np.mean([get_displacement(sample) for sample in samples], axis=0),
        np.mean([sample.proximal_tension for sample in samples], axis=0),
    )
