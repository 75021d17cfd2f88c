"""How far a long computation is, told by its parts."""

from collections.abc import Callable

Report = Callable[[str, float], None]
"""Told what is being done, and which share (0 to 1) of all is done."""


def quiet(_what: str, _share: float) -> None:
    """Report nothing."""


def part(report: Report, begin: float, end: float) -> Report:
    """Return the report of a part that takes the whole from one share to another."""

    def of_part(what: str, share: float) -> None:
        report(what, begin + (end - begin) * share)

    return of_part
