"""Stretches the periods of the view so that it takes no more than its share of a processor.

So does a page that does not keep up: a browser that draws by software takes in a few dozen blocks
with each of its two or three pictures a second, and would fall further behind without end.

Each call and each row has its cost, so the rows drawn of a second become fewer by the same factor.
"""

_SPAN_S = 1.0  # over which the share is measured
_RELAX_FACTOR = 0.8  # per span, of the stretch, while the share is well below the limit
_CALM_SHARE = 0.8  # of the limit: below it the periods may shrink again
_LATE_S, _CURRENT_S = 2.0, 1.0  # [s] a page is behind: stretched above, may relax below
_LATE_FACTOR = 1.25  # per span, of the stretch, while a page is late
_STRETCH_MAX = 10.0  # stretch at most: pieces of a loop must not look like gaps between two loops


class Pacing:
    """Factor of the periods of drawing and of rows, from the processor time used so far.

    Time is an argument, so live use and a test call the same code.

    Parameters
    ----------
    limit : float
        Share of one processor.
    """

    def __init__(self, limit: float) -> None:
        self.stretch = 1.0
        self._limit = limit
        self._since: tuple[float, float] | None = None  # [s] processor time, clock

    def update(self, processor_s: float, now_s: float, behind_s: float = 0.0) -> float:
        """Return the factor.

        Parameters
        ----------
        processor_s, now_s : float
            [s] processor time of this process, and the clock.
        behind_s : float
            [s] by which the slowest page is behind what was sent.
        """
        if self._since is None:
            self._since = processor_s, now_s
        used_s, passed_s = processor_s - self._since[0], now_s - self._since[1]
        if passed_s >= _SPAN_S:
            self._since = processor_s, now_s
            share = used_s / passed_s
            if share > self._limit:
                self.stretch = min(self.stretch * min(share / self._limit, 2.0), _STRETCH_MAX)
            elif behind_s > _LATE_S:
                self.stretch = min(self.stretch * _LATE_FACTOR, _STRETCH_MAX)
            elif share < _CALM_SHARE * self._limit and behind_s < _CURRENT_S:
                self.stretch = max(1.0, self.stretch * _RELAX_FACTOR)
        return self.stretch
