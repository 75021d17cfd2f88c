"""A clock that stands still but for the sleeping of loops, so that every run is the same one."""

from functools import partial
from operator import getitem
from types import SimpleNamespace

import pytest

from teleop.link import reception
from teleop.runtime import clock


class StandingClock:
    """Time of the machine's monotonic clock as the loops see it.

    Attributes
    ----------
    now : callable
        Returns it [ns]; a call of C, as the clock that it stands in for.
    """

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self._now = [10**12]  # the same in every run: loops keep to a grid of it
        self.now = partial(getitem, self._now, 0)
        for module in (clock, reception):
            patch.setattr(module, "time", SimpleNamespace(monotonic_ns=self.now))

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self._now[0] += round(seconds * 1e9)
