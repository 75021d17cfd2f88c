"""Table of the rigs that a config can name; one module each."""

from collections.abc import Callable
from typing import Any

from slave.rig import Rig, RigFault
from slave.rigs.extension import CheckedRig, RigExtension
from slave.rigs.hardware import HardwareRig, HardwareRigConfig
from slave.rigs.replayed_data import ReplayedRig, ReplayedRigConfig
from slave.rigs.simulated import SimulatedRig, SimulatedRigConfig
from teleop.config.extensions import close_extension, format_opening_failure
from teleop.errors import UsageError
from teleop.messages.messages import MAX_JOINTS

RigConfig = SimulatedRigConfig | ReplayedRigConfig | HardwareRigConfig | RigExtension

RIGS: dict[type[Any], Callable[[Any], Rig]] = {
    SimulatedRigConfig: SimulatedRig,
    ReplayedRigConfig: ReplayedRig,
}

RIG_COMPILE_S: dict[type[Any], float] = {
    SimulatedRigConfig: 4.0,
    ReplayedRigConfig: 0.0,
    HardwareRigConfig: 0.0,
}
"""Additional compile time of a slave with this rig [s], on two processors."""


def compile_rig(config: RigConfig) -> None:
    """Compile the functions of a simulated rig; no effect for other rigs."""
    if isinstance(config, SimulatedRigConfig):
        SimulatedRig(config)


def open_rig(config: RigConfig, read_only: bool = False) -> Rig:
    """Open the rig that `config` describes; `UsageError` if it is not available or laid out wrong.

    With `read_only` nothing is written to the buses of real hardware, not even at opening; a rig of
    another package that does not support it (`RigExtension.open_read_only`) is refused.

    Compiled functions take the numbers of its tendons as indices, which they do not check.
    """
    try:
        if isinstance(config, RigExtension):
            rig = wrap_external_rig(
                config.open_read_only() if read_only else config.open(), config.type
            )
        elif isinstance(config, HardwareRigConfig):
            rig = HardwareRig(config, read_only)
        else:
            rig = RIGS[type(config)](config)
    except RigFault as fault:
        raise UsageError(f"slave.rig: {fault}") from fault
    except Exception as error:
        if isinstance(config, RigExtension):
            raise UsageError(format_opening_failure("slave.rig", config, error)) from error
        raise
    if error_text := find_layout_error(rig):
        rig.close()
        raise UsageError(f"slave.rig: {config.type}: {error_text}")
    return rig


def wrap_external_rig(rig: Rig, name: str) -> Rig:
    """Return a rig of another package with its samples checked; closed if it is no rig."""
    try:
        return CheckedRig(rig, name)
    except RigFault:
        if hasattr(rig, "close"):
            close_extension(name, rig)
        raise


def find_layout_error(rig: Rig) -> str:
    """Return what is wrong with the joints of a rig and what they must be; empty if nothing is."""
    joints = rig.joints
    if not 1 <= len(joints) <= MAX_JOINTS or any(len(joint) not in (1, 2) for joint in joints):
        return f"joints {joints}, must be 1 to {MAX_JOINTS} joints of 1 or 2 tendons"
    if [k for joint in joints for k in joint] != list(range(rig.tendons)):
        return (
            f"joints {joints} of {rig.tendons} tendons, must number these from 0, joint after joint"
        )
    return ""
