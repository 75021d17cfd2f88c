"""Processor time for the recorder: enough on a loaded machine, and after the loops."""

import os
from contextlib import suppress

from teleop.runtime.realtime import share_heaps

FALLBACK_NICE = -5  # where real-time scheduling is not allowed, but this is


def request_priority(priority: int) -> list[str]:
    """Let this process go before ordinary programs; return what was granted.

    Called before the link is opened: its threads inherit the priority. At SCHED_RR below that of
    the loops the recorder waits for them, and for nothing else: four programs computing at nice 0
    on two cores otherwise leave it a seventh of one, and messages are lost that it had no time to
    receive. Where nothing is allowed, the loops run at ordinary priority too, and go first.

    Parameters
    ----------
    priority : int
        Of SCHED_RR, from 1; 0 = ordinary scheduling, after the loops.
    """
    share_heaps()
    if priority:
        with suppress(AttributeError, OSError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))
            return [f"SCHED_RR {priority}"]
        with suppress(OSError):
            os.nice(FALLBACK_NICE - os.nice(0))
            return [f"nice {os.nice(0)}"]
    os.nice(5)
    return ["no priority (see `teleop doctor`)"] if priority else []
