"""Measurements of a simulated rig, faster than real time.

run = simulate("configs/demo.yaml", "nested", duration=20.0)
est.diagnose(run.tendon(1))
"""

import dataclasses
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

import numpy as np

from estimator.array_types import Array
from estimator.measured_data import Samples
from slave.config import SlaveConfig
from slave.rig import collect_loop_tensions
from slave.rigs.simulated import JointConfig, SimulatedRig, SimulatedRigConfig, TendonPlantConfig
from slave.sheath_section import SectionConfig
from slave.simulation.effects import EffectConfig
from slave.simulation.environment import FreeConfig
from slave.simulation.joint import BodyConfig
from slave.simulation.tendon import SheathConfig
from teleop.config.loading import load
from teleop.data.measured_table import Columns, write_table
from teleop.data.standard_columns import (
    ANCHOR_TENSION,
    JOINT_ANGLE,
    LOOP_TENSIONS,
    format_numbered_name,
)
from teleop.errors import UsageError

# --- motor motions for simulated measurements: pure functions of time, tension and state


class MotionState(NamedTuple):
    """State of a motion between samples."""

    leg: int = 0  # index of the next turning tension
    target: float = 0.0  # [m] last motor command


class MotionSample(NamedTuple):
    """Input of a motion: one sample."""

    time_s: float  # [s] since the start
    tension: float  # [N] measured at the housing
    dt: float  # [s] until the next


class Motion(Protocol):
    """Interface of a motion of one motor."""

    def step(self, memory: MotionState, sample: MotionSample) -> tuple[float, MotionState]:
        """Return the motor command [m] for the next sample, and the new state."""


@dataclass(frozen=True, slots=True)
class Turns:
    """Constant speed, reversing whenever the housing tension reaches the next of `levels`, cyclic.

    With (20 N, 5 N) this is the pull, release and pull of Phee et al. 2009, Fig. 7; with shrinking
    swings it is nested reversals.
    """

    levels: tuple[float, ...]  # [N] no two neighbours alike, last and first included
    speed: float  # [m/s]

    def step(self, memory: MotionState, sample: MotionSample) -> tuple[float, MotionState]:
        """See `Motion`."""
        leg = memory.leg
        if self._compute_direction(leg) * (sample.tension - self._compute_level(leg)) >= 0.0:
            leg += 1
        target = memory.target + self._compute_direction(leg) * self.speed * sample.dt
        return target, MotionState(leg, target)

    def _compute_level(self, leg: int) -> float:
        return self.levels[leg % len(self.levels)]

    def _compute_direction(self, leg: int) -> float:
        return 1.0 if leg == 0 or self._compute_level(leg) > self._compute_level(leg - 1) else -1.0


@dataclass(frozen=True, slots=True)
class Sine:
    """A sine between the start and `stroke`."""

    stroke: float  # [m]
    period: float  # [s]

    def step(self, memory: MotionState, sample: MotionSample) -> tuple[float, MotionState]:
        """See `Motion`."""
        turn = 2.0 * math.pi * (sample.time_s + sample.dt) / self.period
        target = 0.5 * self.stroke * (1.0 - math.cos(turn))
        return target, memory._replace(target=target)


@dataclass(frozen=True, slots=True)
class TensionHold:
    """Keep the tension near `tension` by admittance control: the other tendon of a pair.

    Motor speed `admittance` (tension - measured), with a dead band, limited to `speed`.
    """

    tension: float  # [N]
    speed: float  # [m/s]
    admittance: float = 0.03  # [m/(s N)]
    band: float = 0.1  # [N] to either side, against limit cycles: a short piece of tendon is stiff

    def step(self, memory: MotionState, sample: MotionSample) -> tuple[float, MotionState]:
        """See `Motion`."""
        error = self.tension - sample.tension
        error -= min(max(error, -self.band), self.band)
        speed = min(max(self.admittance * error, -self.speed), self.speed)
        target = memory.target + speed * sample.dt
        return target, memory._replace(target=target)


@dataclass(frozen=True, slots=True)
class MotionScale:
    """Amplitudes and speeds of the motions."""

    peak: float = 20.0  # [N] highest housing tension, of the motions that turn at tensions
    speed: float = 0.004  # [m/s] of those
    stroke: float = 0.010  # [m] of the sine
    period: float = 4.0  # [s] of the sine


def _build_turns(*shares: float) -> Callable[[MotionScale], Motion]:
    return lambda scale: Turns(tuple(share * scale.peak for share in shares), scale.speed)


MOTIONS: dict[str, Callable[[MotionScale], Motion]] = {
    "pull-release-pull": _build_turns(1.0, 0.25),
    "loop": _build_turns(1.0, 0.01),  # for a calibration: to slack and back
    "nested": _build_turns(1.0, 0.2, 0.8, 0.3, 0.65, 0.4),
    "sine": lambda scale: Sine(scale.stroke, scale.period),
}

DEFAULT_PROFILE, DEFAULT_SCALE = "pull-release-pull", MotionScale()
HOLD_TENSION = 0.5  # [N] enough for a tendon not to go slack
FOLLOW_SPEED = 0.04  # [m/s] most that the loose tendon's motor goes


class BenchRun(NamedTuple):
    """Measurements: times [s], shape (samples,), others of shape (samples, tendons)."""

    time: Array
    proximal_tension: Array  # [N]
    proximal_displacement: Array  # [m]
    distal_tension: Array  # [N]
    distal_displacement: Array  # [m]
    loop_tension: Array | None = None  # [N] of sensing loops, shape (ends, samples, tendons)
    anchor_tension: Array | None = None  # [N] of arms, where tendons end; without noise
    joint_angle: Array | None = None  # [rad] of arms, shape (samples, joints)

    def tendon(self, number: int = 1) -> Samples:
        """Return the samples of one tendon, counted from 1, as the estimator's functions take them.

        Raises
        ------
        UsageError
            There is no such tendon.
        """
        tendons = self.proximal_tension.shape[1]
        if not 1 <= number <= tendons:
            raise UsageError(f"tendon {number}: this rig has 1 to {tendons}")
        k = number - 1
        return Samples(
            self.time,
            self.proximal_tension[:, k],
            self.proximal_displacement[:, k],
            self.distal_tension[:, k],
            self.distal_displacement[:, k],
        )

    def to_columns(self) -> dict[str, Array]:
        """Return the columns of a measured-data file; tendons 2, 3, ... are numbered."""
        columns = {"time_s": self.time}
        loops = () if self.loop_tension is None else self.loop_tension
        for tendon in range(self.proximal_tension.shape[1]):
            names = Columns.from_tendon(tendon + 1).list_names()
            del names["time"]
            columns |= {name: getattr(self, item)[:, tendon] for item, name in names.items()}
            if self.anchor_tension is not None:
                name = format_numbered_name(ANCHOR_TENSION, tendon + 1)
                columns[name] = self.anchor_tension[:, tendon]
            for name, rows in zip(LOOP_TENSIONS, loops, strict=False):
                columns[format_numbered_name(name, tendon + 1)] = rows[:, tendon]
        angles = () if self.joint_angle is None else self.joint_angle.T
        return columns | {JOINT_ANGLE.format(j): angle for j, angle in enumerate(angles, 1)}

    def save(self, path: str | Path) -> None:
        """Write a measured-data file: .csv, .csv.gz or .parquet; `UsageError` if that fails."""
        write_table(Path(path), self.to_columns())


def make_spring_bench(
    length: float = 1.5,
    radius: float = 0.3,
    stiffness: float = 2000.0,
    effects: Sequence[EffectConfig] = (),
) -> SimulatedRigConfig:
    """Return a calibration bench: one tendon, whose tip pulls a spring, sensors at both ends.

    Parameters
    ----------
    length, radius : float
        [m] of the sheath, bent evenly, and of its bend.
    stiffness : float
        [N/m] of the spring.
    effects : sequence of EffectConfig
        What the bench has that the plain model does not: those of `slave.simulation.effects`.
    """
    sheath = SheathConfig(sections=(SectionConfig(length=length, radius=radius),))
    joint = JointConfig(
        tendons=(TendonPlantConfig(sheath=sheath),),
        body=BodyConfig(spring=stiffness, pretension=0.0),
        environment=FreeConfig(),
    )
    return SimulatedRigConfig(joints=(joint,), effects=tuple(effects))


def simulate(
    config: str | Path | SimulatedRigConfig | None = None,
    profile: str | Motion = DEFAULT_PROFILE,
    *,
    duration: float = 30.0,
    rate: float = 1000.0,
    scale: MotionScale = DEFAULT_SCALE,
    seed: int | None = None,
    side: Literal["a", "b"] = "a",
    keep: float = HOLD_TENSION,
    progress: bool = False,
) -> BenchRun:
    """Move all joints of a simulated rig, and measure at both ends as on a calibration bench.

    Motors are commanded at every step of the plant, for any output rate. The same call returns the
    same values.

    Parameters
    ----------
    config : path or SimulatedRigConfig, optional
        Config file whose `slave.rig` is simulated, or that config; without it the built-in values.
    profile : str or Motion
        One of `MOTIONS`: "pull-release-pull" as in the paper's experiment, "loop" as for a
        calibration, "nested" reversals, "sine"; or a motion of your own.
    duration, rate : float
        [s] and [Hz] of the samples.
    scale : MotionScale
        Amplitudes and speeds of a motion by name.
    seed : int, optional
        Of the sensors' noise; the config's by default.
    side : "a" or "b"
        Which tendon of a pair makes the motion; the other one is kept at `keep` [N].
    progress : bool
        Whether to show a progress bar.

    Raises
    ------
    UsageError
        A number is out of its range, the config is invalid or of a real rig, or there is no such
        profile.
    """
    rig_config = config if isinstance(config, SimulatedRigConfig) else load_rig_config(config)
    values = {"duration": duration, "keep": keep, **dataclasses.asdict(scale)}
    try:
        rig_config = check_sampling(rig_config, rate=rate, seed=seed, **values)
    except ValueError as error:
        raise UsageError(str(error)) from error
    if isinstance(profile, str) and profile not in MOTIONS:
        raise UsageError(f"profile {profile!r}: allowed are {', '.join(MOTIONS)}")
    if side not in ("a", "b"):
        raise UsageError(f"side {side!r}: must be a or b")
    motion = MOTIONS[profile](scale) if isinstance(profile, str) else profile
    rig = SimulatedRig(rig_config)
    loose = TensionHold(keep, FOLLOW_SPEED)
    pair = (motion, loose) if side == "a" else (loose, motion)
    motions = [m for tendons in rig.joints for m in (pair if len(tendons) == 2 else (motion,))]
    memories = [MotionState()] * rig.tendons
    period, rows, of_arm = rig_config.period, [], []
    due = [round(k / rate / period) for k in range(int(duration * rate + 1e-9) + 1)]
    kept_rows, last = set(due), due[-1]
    for step in range(last + 1):
        for sample in rig.read(step * period):
            tensions = sample.proximal_tension.tolist()
            moves = [
                move.step(memory, MotionSample(sample.time_s, tension, period))
                for move, memory, tension in zip(motions, memories, tensions, strict=True)
            ]
            memories = [memory for _, memory in moves]
            rig.write(np.array([target for target, _ in moves]))
            if step in kept_rows:
                rows.append(sample)
                if rig_config.arms:
                    of_arm.append((rig.anchor_tensions, rig.joint_angles))
        if progress and (step % 2000 == 0 or step == last):
            _show_progress((step + 1) / (last + 1))
    rig.close()
    if not rows:
        raise UsageError("slave.rig.effects: all samples were lost")
    return BenchRun(
        np.array([row.time_s for row in rows]),
        np.array([row.proximal_tension for row in rows]),
        np.array([row.proximal_displacement for row in rows]),
        np.array([row.bench_distal_tension for row in rows]),
        np.array([row.bench_distal_displacement for row in rows]),
        collect_loop_tensions(rows),
        *(np.array(values) for values in zip(*of_arm, strict=True)),
    )


def load_rig_config(path: str | Path | None, overrides: Sequence[str] = ()) -> SimulatedRigConfig:
    """Return the simulated rig of a config file; `UsageError` if it is invalid or of a real rig."""
    rig = load(None if path is None else Path(path), SlaveConfig, "slave", overrides).rig
    if isinstance(rig, SimulatedRigConfig):
        return rig
    origin = path or "defaults"
    raise UsageError(f"{origin}: slave.rig.type: must be simulated, not {rig.type}")


def check_sampling(
    config: SimulatedRigConfig, *, rate: float, seed: int | None, **values: float
) -> SimulatedRigConfig:
    """Return the config with a seed; `ValueError` unless rate [Hz] and further values can be."""
    for name, value in (("rate", rate), *values.items()):
        if not 0.0 < value <= 1e5:
            raise ValueError(f"{name} {value:g}: must be above 0 and at most 100 000")
    if rate * config.period > 1.0 + 1e-9:
        raise ValueError(f"rate {rate:g}: the rig's slave.rig.period allows 1/period at most")
    return config if seed is None else dataclasses.replace(config, seed=seed)


def _show_progress(share: float) -> None:
    bar = "#" * round(40 * share)
    print(f"\r[{bar:<40}] {share:4.0%}", end="\n" if share == 1.0 else "", file=sys.stderr)
