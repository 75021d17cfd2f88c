"""What was written and what the device did, compared. Pure."""

import statistics
from collections.abc import Sequence
from typing import NamedTuple

from studies.hid.virtual.device import Push
from studies.kernel.cases import Case, Shares

_FORCE_TOLERANCE = 0.015  # of full scale: a direction in a byte turns a force by up to 0.7 degrees
_AHEAD = 6  # forces that may be overtaken by a newer one, in a row


class Sent(NamedTuple):
    """A force as it was handed over, shares of full scale."""

    time: float  # [s]
    force: Shares


class WrongError(Exception):
    """The device or the driver did what it must not; the message says what."""


def match_echoes(
    sent: Sequence[Sent], pushes: Sequence[Push], signs: Sequence[int]
) -> tuple[list[float], int]:
    """Return how long each force took to be felt [s], and how many were never felt.

    Per axis, what the device did must be what was written, in the same order and with the right
    sign; anything else is a `WrongError`.
    """
    delays, missed = [], 0
    for axis, sign in enumerate(signs):
        wanted = [(time, sign * force[axis]) for time, force in sent]
        at = -1
        for time, value in _find_changes([(p.time, p.force[axis]) for p in pushes]):
            ahead = range(at + 1, min(at + 2 + _AHEAD, len(wanted)))
            found = next((k for k in ahead if abs(wanted[k][1] - value) < _FORCE_TOLERANCE), None)
            if found is None:
                near = [f"{t - time:+.4f} s {v:+.3f}" for t, v in wanted[max(at - 1, 0) : at + 8]]
                raise WrongError(
                    f"axis {axis}: pushed with {value:+.3f}, which nobody wrote: {', '.join(near)}"
                )
            missed += found - at - 1
            at = found
            delays.append(time - wanted[at][0])
        missed += len(wanted) - 1 - at
    return delays, missed


def _find_changes(samples: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    kept: list[tuple[float, float]] = []
    last = 0.0
    for time, value in samples:
        if abs(value - last) >= _FORCE_TOLERANCE:
            kept.append((time, value))
            last = value
    return kept


def count_lost_reports(case: Case, decoded: Sequence[Shares]) -> int:
    """Return how many of the hand's positions were left out between the first and the last.

    Each decoded one must be one of the hand's, in order; anything else is a `WrongError`.
    """
    tolerance = 0.6 / case.counts
    lost, at = 0, None
    for shares in decoded:
        ahead = range(5000) if at is None else range(at + 1, at + 100)
        found = next((n for n in ahead if _are_close(case.place_hand(n), shares, tolerance)), None)
        if found is None:
            raise WrongError(f"decoded {shares} after report {at}: no such position")
        lost += 0 if at is None else found - at - 1
        at = found
    return lost


def _are_close(one: Shares, other: Shares, tolerance: float) -> bool:
    return all(abs(a - b) <= tolerance for a, b in zip(one, other, strict=True))


def format_quantiles(delays: Sequence[float]) -> dict[str, str]:
    """Return the middle and the 99th percentile of delays [s] in words."""
    hundredths = statistics.quantiles(delays, n=100)
    return {name: f"{1e3 * hundredths[at - 1]:.2f} ms" for name, at in (("p50", 50), ("p99", 99))}
