"""How far a long computation is, told by its parts."""

from collections.abc import Callable

ProgressCallback = Callable[[str, float], None]
"""Told what is being done, and which share (0 to 1) of all is done."""


def ignore_progress(_what: str, _share: float) -> None:
    """Report nothing."""


def scale_progress(report: ProgressCallback, begin: float, end: float) -> ProgressCallback:
    """Return the report of a part that takes the whole from one share to another."""

    def of_part(what: str, share: float) -> None:
        report(what, begin + (end - begin) * share)

    return of_part
