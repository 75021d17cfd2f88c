"""Records of the slave's tick: settings, samples with their estimates, memory and work arrays."""

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

from estimator.array_types import Array
from estimator.structs import F64, I64, Field, Flag, Struct, build_struct_dtype
from slave import control, fault_detection, gate, initial_position
from slave.calibration import monitor
from slave.calibration.degraded_mode import Degradation
from slave.calibration.monitor import Advice
from slave.calibration.probing import Probe, ProbeConstants, ProbingConfig
from slave.control.joint_estimate import JointEstimate
from slave.rig_layout import EstimatedTendon
from teleop import coupling
from teleop.coupling import Side
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS
from teleop.session import state_machine
from teleop.session.state_machine import Reason, Session

# SlaveMemory.readiness: why the rig is not usable, or that it is
USABLE, NO_SAMPLE, NOT_CALIBRATED, NO_POSITION = range(4)
NOT_READY_TEXT = (
    "",
    "no sample from the rig yet",
    "no calibration fits the rig",
    "no encoder reading yet, and the rig does not start at zero",
)


class SlaveSettings(Struct):
    """Settings of a tick, from the config."""

    control: Annotated[control.ControlConfig, Field(build_struct_dtype(control.ControlConfig))]
    fault_detection: Annotated[
        fault_detection.FaultDetectionConfig,
        Field(build_struct_dtype(fault_detection.FaultDetectionConfig)),
    ]
    gate: Annotated[gate.GateConfig, Field(build_struct_dtype(gate.GateConfig))]
    monitor: Annotated[monitor.MonitorConfig, Field(build_struct_dtype(monitor.MonitorConfig))]
    probing: Annotated[ProbingConfig, Field(build_struct_dtype(ProbingConfig))]
    probed: Annotated[Sequence[ProbeConstants], Field(ProbeConstants, MAX_TENDONS)]
    bilateral: coupling.BilateralSettings
    sample_timeout: F64 = 0.1  # [s]
    is_actuated: Flag = True  # the motors follow commands
    calibrated: Flag = True  # a calibration fits the rig
    degrades: Flag = False  # a demanded calibration limits the session instead of ending it


class EstimatedSample(Struct):
    """One sample of the rig with the estimates from it."""

    time_s: F64 = 0.0  # [s] on the rig's clock
    elapsed: F64 = 0.0  # [s] since the sample before
    has_displacement: Flag = False  # whether the rig has encoders
    tendons: Annotated[Sequence[EstimatedTendon], Field(EstimatedTendon, MAX_TENDONS)]
    bench_tension: Annotated[Array, Field("f8", MAX_TENDONS, fill=math.nan)]  # [N] at the tip
    bench_displacement: Annotated[Array, Field("f8", MAX_TENDONS, fill=math.nan)]  # [m]
    # [N] at the moved and at the held end of sensing loops
    loop_tension: Annotated[Array, Field("f8", (MAX_TENDONS, 2), fill=math.nan)]


class SlaveMemory(Struct):
    """State of the slave between ticks, except for the tendons' estimators."""

    session: Session
    initial_position: initial_position.InitialPosition
    detector: fault_detection.FaultDetector
    motors: fault_detection.MotorChecks
    control: control.ControllerState
    coupling: Side
    tendons: Annotated[Sequence[EstimatedTendon], Field(EstimatedTendon, MAX_TENDONS)]  # newest
    joints: Annotated[Sequence[JointEstimate], Field(JointEstimate, MAX_JOINTS)]
    reach: Annotated[Sequence[gate.Reach], Field(gate.Reach, MAX_TENDONS)]
    offsets: Annotated[Array, Field("f8", MAX_TENDONS)]  # [m] of each tendon
    # [N] of `estimate_arm_forces`
    arm_force: Annotated[Array, Field("f8", (3, MAX_JOINTS), fill=math.nan)]
    gated_position: Annotated[Array, Field("f8", MAX_TENDONS)]  # [m] last output of the gate
    has_sample: Flag = False
    has_offsets: Flag = False
    has_gated_position: Flag = False  # something was written: engaged at least once, or calibrated
    sample_time: F64 = 0.0  # [s] of the newest sample
    sample_age: F64 = 0.0  # [s] since the last new and usable sample
    overload: F64 = 0.0  # [s] for which a tension has been far over its limit while engaged
    detected_fault: I64 = Reason.NONE  # Reason that the fault detection gave last
    faulty_tendon: I64 = -1
    advice: I64 = Advice.NONE
    degradation: Degradation
    probe: Probe
    readiness: I64 = NO_SAMPLE
    # last, as no tick changes them (`SlaveRecords.restorable_arrays`)
    monitors: Annotated[Sequence[monitor.TendonMonitor], Field(monitor.TendonMonitor, MAX_TENDONS)]


class Scratch(Struct):
    """Work arrays of a tick."""

    inputs: state_machine.SessionInputs
    requested: Annotated[Array, Field("f8", MAX_JOINTS)]  # [m] of the joints
    tip_velocity: Annotated[Array, Field("f8", MAX_JOINTS)]  # [m/s]
    force: Annotated[Array, Field("f8", MAX_JOINTS)]  # [N] rendered to the hand
    displacement: Annotated[Array, Field("f8", MAX_TENDONS)]  # [m] of the motors in a sample
    tension: Annotated[Array, Field("f8", MAX_TENDONS)]  # [N] used for the limits
    motor_position: Annotated[Array, Field("f8", MAX_TENDONS)]  # [m] present motor positions
    motor_target: Annotated[Array, Field("f8", MAX_TENDONS)]  # [m] motor targets
    has_extension_target: Flag = False  # whether the controller of an extension gives the targets
    extension_target: Annotated[Array, Field("f8", MAX_TENDONS)]  # [m]


class TickInput(NamedTuple):
    """Inputs of a tick besides samples and command."""

    dt: float  # [s] since the last tick
    has_command: bool  # whether a command ever came
    fresh: bool  # whether the newest command is younger than its timeout
    fault: int = int(Reason.NONE)  # Reason: fault on this side detected by the caller
    stop: int = int(Reason.NONE)  # Reason of an emergency stop by another process
    reset: bool = False  # whether a stop is reset
    link: int = int(Reason.NONE)  # Reason: bound that the link exceeds
    link_holds: bool = False  # whether the session must hold because of it
    motors_follow: bool = True  # `slave.rig.has_following_motors`
