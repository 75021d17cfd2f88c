"""Whether motors go where they are sent, and whether what is measured goes with them.

A driver that gives its last frame again and again looks like a rig at rest: no tension limit would
ever be reached. So readings of a tendon that are alike to the bit, tension and travel, count as
none once its motor has been sent on.
"""

from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple

from slave.control import TendonSeen
from slave.watch.config import WatchConfig
from slave.watch.sample import Finding
from teleop.session import Reason


class Reading(NamedTuple):
    """A tendon's newest reading."""

    tension: float  # [N]
    displacement: float  # [m]
    sent: float  # [m] where the motor had been sent when it came for the first time


class Motors(NamedTuple):
    """What is remembered of the motors."""

    readings: tuple[Reading, ...] = ()  # of each tendon; none before a motor was sent anywhere
    repeated: bool = False  # whether the newest reading of a motor sent on is what it was before
    late: float = 0.0  # [s] for which a motor has been far from where it was sent


def watch_motors(
    config: WatchConfig,
    memory: Motors,
    samples: Sequence[Sequence[TendonSeen]],
    sent: Sequence[float],
    dt: float,
) -> tuple[Finding | None, Motors]:
    """Return the motor that does not go where it is sent, if there is one, and the new memory.

    Parameters
    ----------
    samples : sequence of sequences of TendonSeen
        All tendons in each sample since the last tick, oldest first.
    sent : sequence of float
        Where the motors were sent last [m]; empty if they never were.
    dt : float
        Time since the last tick [s].
    """
    if not sent:
        return None, Motors()
    readings = memory.readings
    for tendons in samples:
        told = tuple(
            Reading(t.tension, t.displacement, s) for t, s in zip(tendons, sent, strict=True)
        )
        readings = tuple(map(_kept, readings, told)) if readings else told
    if not readings:
        return None, memory
    both = tuple(zip(sent, readings, strict=True))
    gaps = [abs(s - r.displacement) if isfinite(r.displacement) else 0.0 for s, r in both]
    repeated = memory.repeated
    if samples:
        repeated = any(abs(s - r.sent) > config.stuck_travel for s, r in both)
    late = memory.late + dt if max(gaps) > config.motor_lag else 0.0
    astray = late > config.motor_lag_time
    found = Finding(Reason.MOTOR_ASTRAY, gaps.index(max(gaps))) if astray else None
    return found, Motors(readings, repeated, late)


def _kept(before: Reading, now: Reading) -> Reading:
    """Return the reading before if the new one is the same; one without an encoder never is."""
    return before if before[:2] == now[:2] else now
