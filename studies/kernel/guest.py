"""The HID checks, run as the first process of a virtual machine."""

import traceback
from collections.abc import Callable

from studies.kernel.cases import CASES, Case
from studies.kernel.checks import checks_for
from studies.kernel.init import run, words
from studies.kernel.judge import WrongError
from studies.kernel.plugged import Plugged
from tests.hid.virtual.device import VirtualDevice


def main() -> None:
    """Never returns."""
    run(_try_all)


def _try_all(say: Callable[..., None]) -> None:
    names = words("devices")
    for case in CASES:
        if case.name in names:
            _try(case, say)


def _try(case: Case, say: Callable[..., None]) -> None:
    def hand(moved: VirtualDevice, n: int) -> None:
        moved.axes[: len(case.inputs)] = case.hand(n)

    case.hand(0)
    with Plugged(case.device(), hand) as rig:
        for check in checks_for(case):
            try:
                figures = check(case, rig)
            except WrongError as error:
                say(device=case.name, check=check.__name__, trouble=str(error))
            except Exception as error:  # whatever it is, the other trials still run
                traceback.print_exc()
                say(device=case.name, check=check.__name__, trouble=repr(error))
            else:
                say(device=case.name, check=check.__name__, figures=figures)
