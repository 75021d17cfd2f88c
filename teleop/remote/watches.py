"""Watchdog processes of a session: the end of one, for any reason, is an emergency stop.

A watch sends a heartbeat every `BEAT_S` and is armed from the first one. It is lost after
`SILENCE_S` without a heartbeat (frozen or disconnected), or when its presence token vanishes (it
died); a LEAVE message ends it without a stop. Pure.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

BEAT_S = 0.05  # [s] between two beats
SILENCE_S = 0.25  # [s] timeout: five heartbeats


class Heartbeat(NamedTuple):
    """A heartbeat."""

    watch: int  # nonce of its process
    heard_ns: int  # on our clock
    leaves: bool


class ArmedWatch(NamedTuple):
    """An armed watch."""

    watch: int
    heard_ns: int  # its newest heartbeat
    seen: bool  # whether its token was present


def update_watches(
    armed: tuple[ArmedWatch, ...],
    beats: Iterable[Heartbeat],
    present: Callable[[int], bool],
    now_ns: int,
) -> tuple[tuple[ArmedWatch, ...], bool]:
    """Return the watches that are armed after a tick, and whether one was lost in it.

    Parameters
    ----------
    armed : tuple of ArmedWatch
        Those of the tick before.
    beats : iterable of Beat
        Heartbeats since, oldest first.
    present : callable
        Returns whether the token of a nonce is present.
    now_ns : int
        Stamp of this tick [ns].
    """
    known = {one.watch: one for one in armed}
    for beat in beats:
        if beat.leaves:
            known.pop(beat.watch, None)
        else:
            seen = beat.watch in known and known[beat.watch].seen
            known[beat.watch] = ArmedWatch(beat.watch, beat.heard_ns, seen)
    kept = []
    for one in known.values():
        here = present(one.watch)
        silent = now_ns - one.heard_ns > SILENCE_S * 1e9
        if not silent and (here or not one.seen):
            kept.append(one._replace(seen=here))
    return tuple(kept), len(kept) < len(known)
