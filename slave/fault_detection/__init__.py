"""Fault detection of tendons, load cells and motors.

Broken and jammed tendons, stuck and saturated load cells, motors off their set position: `step`
checks every sample, whether engaged or not, `check_motors` every tick. Thresholds
and detection times: docs/explanation/control.md.
"""

from slave.fault_detection.config import FaultDetectionConfig
from slave.fault_detection.detector import FaultDetector, init_detector, step
from slave.fault_detection.motors import MotorChecks, check_motors, record_motor_readings

__all__ = [
    "FaultDetectionConfig",
    "FaultDetector",
    "MotorChecks",
    "check_motors",
    "init_detector",
    "record_motor_readings",
    "step",
]
