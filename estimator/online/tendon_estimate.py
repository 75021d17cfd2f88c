"""What the estimator says of one tendon at one instant, as a record."""

import math
from enum import IntFlag

from estimator.structs import F64, I64, Struct


class Status(IntFlag):
    """What limits an estimate; 0 is a plain one.

    TENSION_ONLY: no displacement, so the motor is taken to drive and the interval is (T2).
    UNINITIALISED: T_in has not swung by e^2K since the start, so the initial profile is assumed.
    TIP_MOVED: the sliding direction says that the tip drives. SLACK: no tension within the noise.
    INVALID_INPUT: the sample was refused, the estimate is the last one, the interval widens.
    """

    OK = 0
    TENSION_ONLY = 1
    UNINITIALISED = 2
    TIP_MOVED = 4
    SLACK = 8
    INVALID_INPUT = 16


TENSION_ONLY = int(Status.TENSION_ONLY)
UNINITIALISED = int(Status.UNINITIALISED)
TIP_MOVED = int(Status.TIP_MOVED)
SLACK = int(Status.SLACK)
INVALID_INPUT = int(Status.INVALID_INPUT)


class TendonEstimate(Struct):
    """One tendon at one instant."""

    distal_tension: F64 = 0.0  # [N] T_out
    low: F64 = 0.0  # [N] least T_out that the data and the noise allow
    high: F64 = math.inf  # [N] largest; inf before the first valid sample
    adapted_low: F64 = 0.0  # [N] T_out with an adapted K at the end of its interval that lowers it
    adapted_high: F64 = 0.0  # [N] and at the one that raises it
    elongation: F64 = 0.0  # [m] e
    distal_displacement: F64 = math.nan  # [m] q_p - e up to a constant; NaN without displacement
    front: F64 = 0.0  # [m] X'
    phase: I64 = 0  # estimator.law.transmission.Phase, next to the motor
    status: I64 = 0  # bits of Status
