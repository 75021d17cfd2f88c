"""Detect a broken tendon by the length wound in since it lost its tension.

A moving joint may slacken a tendon, and winding it in makes it taut again. One that is wound in
further than the joint can have moved is broken.
"""

from math import nan

from estimator.compiled import jit_compile
from estimator.records import F64, Struct
from slave.fault_detection.config import FaultDetectionConfig


class SlackState(Struct):
    """State of a tendon without tension; the defaults are those of a taut one."""

    time: F64 = -1.0  # [s] since the tension was lost; below 0 while taut
    lost: F64 = 0.0  # [N] tension before
    wound: F64 = nan  # [m] wound in by the joint's motors when it went slack


@jit_compile
def check_slack(
    config: FaultDetectionConfig,
    slack: SlackState,
    tension: float,
    before: float,
    wound: float,
    dt: float,
) -> bool:
    """Process one sample of a tendon; return whether the tendon is broken.

    Parameters
    ----------
    slack : Slack
        Changed in place.
    tension, before : float
        At the housing [N], of this sample and of the last few.
    wound : float
        Length wound in by all motors of its joint [m].
    dt : float
        Time since the last sample [s].
    """
    if tension > config.slack:
        slack.time, slack.lost, slack.wound = -1.0, 0.0, nan
        return False
    if slack.time < 0.0:
        slack.time, slack.lost, slack.wound = 0.0, before, wound
        return False
    slack.time += dt
    return slack.wound + config.take_up < wound


@jit_compile
def is_slack_longer(slack: SlackState, other: SlackState) -> bool:
    """Return whether a tendon lost its tension first; at the same time, whether it had more."""
    if slack.time != other.time:
        return slack.time > other.time
    if slack.lost != other.lost:
        return slack.lost > other.lost
    return slack.wound > other.wound
