"""A session whose recorder tells what an observer, a viewer or a ROS node, does to both loops."""

import math
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from studies.testbed.processes import DEMO_CONFIG, Processes
from teleop.recording.reader import read_columns
from teleop.runtime.clock import now_ns


class ObservedSession(Processes):
    """Recorder, slave and master of the demo; `measure` spans of it, then `report` them.

    The states of the observer take turns in one run, so all meet the same machine.
    """

    def __init__(self, folder: Path, span_s: float) -> None:
        super().__init__(folder, DEMO_CONFIG)
        self._span_s = span_s
        self._spans: dict[str, list[tuple[int, int]]] = defaultdict(list)

    def measure(self, state: str, settle_s: float) -> None:
        """Count the next seconds for a state of the observer, from `settle_s` on."""
        time.sleep(settle_s)
        begin = now_ns()
        time.sleep(self._span_s)
        self._spans[state].append((begin, now_ns()))

    def report(self, observer: str) -> None:
        """Print period and latency in each state, when the recorder has ended."""
        hand = read_columns(self.recording(), "hand", ["stamp_ns", "round_trip_ns"])
        slave = read_columns(self.recording(), "state", ["stamp_ns"])
        Values = Callable[[NDArray[np.bool_]], NDArray[np.int64]]
        table: list[tuple[str, NDArray[np.int64], Values]] = [
            ("master, period", hand["stamp_ns"], lambda inside: np.diff(hand["stamp_ns"][inside])),
            ("slave, period", slave["stamp_ns"], lambda inside: np.diff(slave["stamp_ns"][inside])),
            ("command to force", hand["stamp_ns"], lambda inside: hand["round_trip_ns"][inside]),
        ]
        print(f"{'[ms]':18}{observer:>9}{'p50':>8}{'p99':>8}{'p99.9':>8}   each round's p99")
        for name, stamps, values in table:
            for state, spans in self._spans.items():
                rounds = [values((stamps >= begin) & (stamps < end)) for begin, end in spans]
                rounds = [some[some > 0] for some in rounds]
                p50, p99, p999 = compute_percentiles_ms(np.concatenate(rounds))
                each = "  ".join(f"{compute_percentiles_ms(some)[1]:.2f}" for some in rounds)
                print(f"{name:18}{state:>9}{p50:8.3f}{p99:8.3f}{p999:8.3f}   {each}")


def compute_percentiles_ms(values_ns: NDArray[np.int64]) -> list[float]:
    """Return the percentiles 50, 99 and 99.9; NaN where no command came back."""
    if not len(values_ns):
        return [math.nan] * 3
    percentiles: list[float] = (np.percentile(values_ns, [50, 99, 99.9]) * 1e-6).tolist()
    return percentiles
