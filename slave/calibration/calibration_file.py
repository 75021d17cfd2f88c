"""Calibration files: the parameters of a rig's tendons, and their evidence."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from slave.tendon_config import TendonConfig
from teleop.config import loading, strict_yaml
from teleop.config.arm import ArmConfig
from teleop.errors import UsageError
from teleop.messages.messages import MAX_TENDONS
from teleop.runtime.process import write_text_file

JointTendons = tuple[tuple[int, ...], ...]


@dataclass(frozen=True, slots=True)
class ValueWithUncertainty:
    """A number and its standard uncertainty, in the same unit."""

    value: float
    uncertainty: float = 0.0


@dataclass(frozen=True, slots=True)
class TendonCalibration:
    """Calibration of one tendon against its stop; docs/how-to/calibrate.md has the methods.

    The paper's K needs EA and L.
    """

    joint: int  # from 1
    tendon: str  # a or b
    K: ValueWithUncertainty  # the one to use: of the whole loop, and of the drags of two tendons
    K_slopes: ValueWithUncertainty  # ln(M_rel / M_pull)
    M_pull: ValueWithUncertainty  # [m/N]
    M_rel: ValueWithUncertainty  # [m/N]
    stiffness_per_length: ValueWithUncertainty  # EA/L [N/m]
    uniform: bool  # whether these two K agree: the curvature is even
    stop: float  # [m] travel of the unstretched tendon at its stop, as the encoder counts
    free_tension: float  # [N] at the housing, of the joint moving freely just before its stop
    K_paper: ValueWithUncertainty | None = (
        None  # from Phee et al. 2009, eq. (13), with the slope M_pull
    )
    K_paper_ratio: ValueWithUncertainty | None = (
        None  # from elongation over tension, as in the paper
    )
    zero: float | None = None  # [N] reading of the other tendon's load cell while that is slack
    remark: str = ""


@dataclass(frozen=True, slots=True)
class GuideFriction:
    """Friction of the tendons that pass a joint of an arm."""

    joint: int  # from 1
    friction: ValueWithUncertainty  # mu at its guide
    friction_error: float = 0.25  # relative, for the interval of the force


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """A calibration file: the models of all tendons of a rig, and where they come from."""

    rig: str = ""  # its name; empty = any rig
    joints: JointTendons = ()  # the tendons of each joint, counted from 0; empty = unknown
    time: str = ""  # ISO 8601, UTC
    method: str = ""
    source: str = ""  # origin, if not measured on the rig itself
    accepted: bool = True  # whether the method accepts its own result
    remark: str = ""
    tendons: tuple[TendonConfig, ...]  # in the order of the rig; a single one is used for all
    directions: tuple[TendonCalibration, ...] = ()
    ranges: tuple[float | None, ...] = ()  # [m] travel of each joint between its stops
    guides: tuple[GuideFriction, ...] = ()  # of passed joints; replaces the friction of `arms`

    def __post_init__(self) -> None:
        if not 1 <= len(self.tendons) <= MAX_TENDONS:
            raise ValueError(f"tendons: 1 to {MAX_TENDONS} are needed")
        numbered = sorted(k for joint in self.joints for k in joint)
        if self.joints and numbered != list(range(len(self.tendons))):
            raise ValueError("joints: must name each tendon once, counted from 0")


def apply_guide_friction(
    arms: Sequence[ArmConfig], guides: Sequence[GuideFriction]
) -> tuple[ArmConfig, ...]:
    """Return arms with the calibrated friction at passed joints, and the largest error of it."""
    measured, first, applied = {guide.joint - 1: guide for guide in guides}, 0, []
    for arm in arms:
        known = {j: measured[first + j] for j in range(arm.joints) if first + j in measured}
        first += arm.joints
        friction = list(arm.list_friction())
        for j, guide in known.items():
            friction[j] = guide.friction.value
        error = max((guide.friction_error for guide in known.values()), default=arm.friction_error)
        applied.append(replace(arm, friction=tuple(friction), friction_error=error))
    return tuple(applied)


class RigDescription(Protocol):
    """The properties of a rig that a calibration must match."""

    @property
    def name(self) -> str:
        """Name of the rig in calibration files."""

    @property
    def joints(self) -> JointTendons:
        """The tendons of each joint, counted from 0."""


def load(path: Path) -> Calibration:
    """Read a calibration file; `UsageError` if it is not one."""
    document = loading.ConfigDocument(path, strict_yaml.read_text(path, "calibration"))
    if session_keys := document.tree.keys() & set(loading.SESSION_KEYS):
        raise UsageError(
            f"{path}: is a session config (it has {min(session_keys)!r}), not a calibration; give "
            "the file written by `teleop calibrate` or `teleop estimate --fit --save`"
        )
    return document.load(Calibration)


def save(path: Path, calibration: Calibration) -> None:
    """Write a calibration file atomically."""
    text = strict_yaml.format_document(loading.as_tree(calibration))
    write_text_file(path, text, "the calibration")


def find_misfit(calibration: Calibration, rig: RigDescription, by_name: bool = True) -> str | None:
    """Return why a calibration must not be used on a rig, None if it may.

    Without `by_name` only the number of tendons is checked, for rigs that are not driven.
    """
    tendons = sum(len(joint) for joint in rig.joints)
    if calibration.joints and calibration.joints != rig.joints:
        return (
            f"it describes the joints {_format_joints(calibration.joints)}, "
            f"{_describe_rig_joints(rig)}"
        )
    if len(calibration.tendons) not in (1, tendons):
        return f"it describes {len(calibration.tendons)} tendons, {_describe_rig_joints(rig)}"
    if not by_name:
        return None
    if calibration.rig != rig.name:
        of = f"for the rig {calibration.rig!r}" if calibration.rig else "for no named rig"
        return f"it is {of}, this one is {rig.name!r}"
    if not calibration.accepted:
        return f"it is not accepted: {calibration.remark}"
    return None


def _describe_rig_joints(rig: RigDescription) -> str:
    return f"the rig has {_format_joints(rig.joints)}"


def _format_joints(joints: JointTendons) -> str:
    return ", ".join("+".join(str(k + 1) for k in joint) for joint in joints) + " (tendons)"
