"""Durations of the stages from hand to force."""

from collections.abc import Sequence
from typing import Any

from teleop.messages.messages import STAGE_NAMES, Latency
from teleop.messages.topics import Role
from teleop.runtime.timing import Durations


class StageMeter:
    """Durations of the stages of `STAGE_NAMES`, for the whole run and since the last report."""

    def __init__(self) -> None:
        self._stages = tuple(Durations() for _ in STAGE_NAMES)

    def add(self, durations_ns: Sequence[int]) -> None:
        """Add one command; a duration [ns] per stage."""
        for stage, duration in zip(self._stages, durations_ns, strict=True):
            stage.add(duration)

    def message(self, role: Role) -> Latency:
        """Return the message for listeners, and start a new span."""
        spans = [stage.take_span() for stage in self._stages]
        return Latency(
            role=role,
            answered=spans[0].values,
            p50_ns=tuple(span.p50 for span in spans),
            p99_ns=tuple(span.p99 for span in spans),
            p99_9_ns=tuple(span.p99_9 for span in spans),
            max_ns=tuple(span.largest for span in spans),
        )

    def summary(self) -> dict[str, dict[str, Any]]:
        """Return percentiles [us] of the whole run, by the stages' names."""
        return {
            name: stage.percentiles(1e-3)
            for name, stage in zip(STAGE_NAMES, self._stages, strict=True)
        }
