"""How far a tendon was wound in since it lost its tension.

What moves a joint may slacken a tendon, and winding it in makes it taut again. One that is wound in
further than the joint can have been moved is broken.
"""

from math import nan

from estimator.compiled import compiled
from estimator.records import F64, Record
from slave.fault_detection.config import FaultDetectionConfig


class Slack(Record):
    """Since when a tendon has had no tension; the defaults are those of a taut one."""

    time: F64 = -1.0  # [s] since it lost it; below 0 while it is taut
    lost: F64 = 0.0  # [N] what it had before
    wound: F64 = nan  # [m] what the motors of its joint had wound in as it went slack


@compiled
def check_slack(
    config: FaultDetectionConfig,
    slack: Slack,
    tension: float,
    before: float,
    wound: float,
    dt: float,
) -> bool:
    """Take one sample of a tendon; return whether the tendon must be broken.

    Parameters
    ----------
    slack : Slack
        Changed in place.
    tension, before : float
        At the housing [N], of this sample and of the last few.
    wound : float
        What the motors of its joint have wound in together [m].
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


@compiled
def is_slack_longer(slack: Slack, other: Slack) -> bool:
    """Return whether a tendon lost its tension before another; if together, whether it had more."""
    if slack.time != other.time:
        return slack.time > other.time
    if slack.lost != other.lost:
        return slack.lost > other.lost
    return slack.wound > other.wound
