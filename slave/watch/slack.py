"""How far a tendon was wound in since it lost its tension.

What moves a joint may slacken a tendon, and winding it in makes it taut again. One that is wound in
further than the joint can have been moved is broken.
"""

from math import nan
from typing import NamedTuple

from slave.watch.config import WatchConfig


class Slack(NamedTuple):
    """A tendon without tension."""

    time: float  # [s] since it lost it; below 0 while it is taut
    lost: float  # [N] what it had before
    wound: float  # [m] what the motors of its joint had wound in as it went slack


TAUT = Slack(-1.0, 0.0, nan)


def watch_slack(
    config: WatchConfig, slack: Slack, tension: float, before: float, wound: float, dt: float
) -> tuple[bool, Slack]:
    """Return whether a tendon must be broken, and the new memory.

    Parameters
    ----------
    tension, before : float
        At the housing [N], of this sample and of the last few.
    wound : float
        What the motors of its joint have wound in together [m].
    dt : float
        Time since the last sample [s].
    """
    if tension > config.slack:
        return False, TAUT
    if slack.time < 0.0:
        return False, Slack(0.0, before, wound)
    return slack.wound + config.take_up < wound, slack._replace(time=slack.time + dt)
