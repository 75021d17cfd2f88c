"""Processes that watch over a session: whose end, whatever its cause, is an emergency stop.

A watch says that it is there every `BEAT_S`. From its first beat on it is armed. It is lost when it
has been silent for `SILENCE_S` (frozen, or its line is cut) or its presence token has vanished (it
died, which shows at once); it leaves in peace by saying so. Pure.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

BEAT_S = 0.05  # [s] between two beats
SILENCE_S = 0.25  # [s] five beats: one may be lost or late without a stop


class Beat(NamedTuple):
    """One word of a watch."""

    watch: int  # nonce of its process
    heard_ns: int  # on our clock
    leaves: bool


class ArmedWatch(NamedTuple):
    """A watch that has been heard."""

    watch: int
    heard_ns: int  # its newest beat
    seen: bool  # its token, so that it can vanish


def update(
    armed: tuple[ArmedWatch, ...],
    beats: Iterable[Beat],
    present: Callable[[int], bool],
    now_ns: int,
) -> tuple[tuple[ArmedWatch, ...], bool]:
    """Return the watches that are armed after a tick, and whether one was lost in it.

    Parameters
    ----------
    armed : tuple of ArmedWatch
        Those of the tick before.
    beats : iterable of Beat
        What was heard since, oldest first.
    present : callable
        Whether the token of the process of a nonce is there.
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
