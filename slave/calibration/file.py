"""Calibration files: the parameters of a rig's tendons, and their evidence."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import yaml

from slave.tendon_config import TendonConfig
from teleop import config, strict_yaml
from teleop.errors import UsageError
from teleop.messages import MAX_TENDONS
from teleop.process import write_whole

JointTendons = tuple[tuple[int, ...], ...]


@dataclass(frozen=True, slots=True)
class Value:
    """A number and its standard uncertainty, in the same unit."""

    value: float
    uncertainty: float = 0.0


@dataclass(frozen=True, slots=True)
class Direction:
    """What pulling one tendon against its stop has shown; the methods are in docs/calibration.md.

    K by the paper is there where EA and L were known beforehand.
    """

    joint: int  # from 1
    tendon: str  # a or b
    K: Value  # by the whole loop, and by the drags if there are two tendons: the one to use
    K_slopes: Value  # ln(M_rel / M_pull)
    M_pull: Value  # [m/N]
    M_rel: Value  # [m/N]
    stiffness_per_length: Value  # EA/L [N/m]
    uniform: bool  # whether these two K agree: the curvature is even
    stop: float  # [m] travel of the unstretched tendon at its stop, as the encoder counts
    free_tension: float  # [N] at the housing, of the joint moving freely just before its stop
    K_paper: Value | None = None  # by Phee et al. 2009, eq. (13), from the slope M_pull
    K_paper_ratio: Value | None = None  # from elongation over tension, as it was done there
    zero: float | None = None  # [N] that the other tendon's load cell reads while that is slack
    remark: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """A calibration file: the models of all tendons of a rig, and where they come from."""

    rig: str = ""  # its name; empty = of no rig in particular
    joints: JointTendons = ()  # the tendons of each joint, counted from 0; empty = not said
    time: str = ""  # ISO 8601, UTC
    method: str = ""
    source: str = ""  # where it was not measured on the rig itself
    accepted: bool = True  # whether the method accepts its own result
    remark: str = ""
    tendons: tuple[TendonConfig, ...]  # numbered as the rig numbers them; one alone is for all
    directions: tuple[Direction, ...] = ()
    ranges: tuple[float | None, ...] = ()  # [m] travel of each joint between its stops

    def __post_init__(self) -> None:
        """Refuse an empty one, and one that contradicts itself."""
        if not 1 <= len(self.tendons) <= MAX_TENDONS:
            raise ValueError(f"tendons: 1 to {MAX_TENDONS} are needed")
        numbered = sorted(k for joint in self.joints for k in joint)
        if self.joints and numbered != list(range(len(self.tendons))):
            raise ValueError("joints: must name each of the tendons once, counted from 0")


class RigDescription(Protocol):
    """Of a rig, what a calibration must fit."""

    @property
    def name(self) -> str:
        """By which calibration files know it."""

    @property
    def joints(self) -> JointTendons:
        """The tendons of each joint, counted from 0."""


def load(path: Path) -> Calibration:
    """Read a calibration file; `UsageError` if it is none."""
    session_keys = set(strict_yaml.read(path, "calibration")) & {*config.SHARED, *config.SECTIONS}
    if session_keys:
        raise UsageError(
            f"{path}: is a session config (it has {min(session_keys)!r}), not a calibration; give "
            "the file written by `teleop calibrate` or `teleop estimate --fit --save`"
        )
    return config.load(path, Calibration, None)


def save(path: Path, calibration: Calibration) -> None:
    """Write a calibration file, whole or not at all."""
    text = yaml.safe_dump(config.as_tree(calibration), sort_keys=False, allow_unicode=True)
    write_whole(path, text, "the calibration")


def fits(calibration: Calibration, rig: RigDescription, by_name: bool = True) -> str | None:
    """Return why a calibration must not be used on a rig, None if it may.

    Without `by_name` only the number of tendons counts: what is not driven can do no harm.
    """
    tendons = sum(len(joint) for joint in rig.joints)
    if calibration.joints and calibration.joints != rig.joints:
        return f"it describes the joints {_shown(calibration.joints)}, {_its(rig)}"
    if len(calibration.tendons) not in (1, tendons):
        return f"it describes {len(calibration.tendons)} tendons, {_its(rig)}"
    if not by_name:
        return None
    if calibration.rig != rig.name:
        of = f"of the rig {calibration.rig!r}" if calibration.rig else "of no rig that it names"
        return f"it is {of}, this one is {rig.name!r}"
    if not calibration.accepted:
        return f"it is not accepted: {calibration.remark}"
    return None


def _its(rig: RigDescription) -> str:
    return f"the rig has {_shown(rig.joints)}"


def _shown(joints: JointTendons) -> str:
    return ", ".join("+".join(str(k + 1) for k in joint) for joint in joints) + " (tendons)"
