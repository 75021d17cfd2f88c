"""What runs in the virtual machine, as its first process: prepare it, run all checks, switch off.

Results go to the second serial line, one JSON object a line; words go to the first.
"""

import ctypes
import json
import os
import sys
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TextIO

from benchmarks.kernel.cases import CASES, Case
from benchmarks.kernel.checks import checks_for
from benchmarks.kernel.image import MODULES
from benchmarks.kernel.judge import WrongError
from benchmarks.kernel.plugged import Plugged
from tests.hid.virtual.device import VirtualDevice

_RESTART = 0x01234567
_FINIT_MODULE = 313  # of x86-64
_RESULTS = Path("/dev/ttyS1")
_LIBC = ctypes.CDLL(None, use_errno=True)


def main() -> None:
    """Never returns."""
    try:
        _prepare()
        with _RESULTS.open("w") as results:
            say = partial(_say, results)
            cases = _asked()
            say(check="boot", figures={"ready after": f"{time.monotonic():.1f} s"})
            for case in cases:
                _try(case, say)
            say(check="end", figures={"after": f"{time.monotonic():.1f} s"})
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os.sync()
        _LIBC.reboot(_RESTART)


def _prepare() -> None:
    for kind, place in (("proc", "/proc"), ("sysfs", "/sys"), ("devtmpfs", "/dev")):
        if _LIBC.mount(kind.encode(), place.encode(), kind.encode(), 0, None) != 0:
            raise OSError(ctypes.get_errno(), f"mount {place}")
    for module in sorted(Path(MODULES).iterdir()):
        with module.open("rb") as file:
            if _LIBC.syscall(_FINIT_MODULE, file.fileno(), b"", 0) != 0:
                raise OSError(ctypes.get_errno(), f"module {module}")


def _asked() -> list[Case]:
    """Return the devices that the kernel's command line names: devices=first,second."""
    words = Path("/proc/cmdline").read_text().split()
    names = next(word for word in words if word.startswith("devices=")).partition("=")[2]
    return [case for case in CASES if case.name in names.split(",")]


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


def _say(results: TextIO, **what: object) -> None:
    results.write(json.dumps(what) + "\n")
    results.flush()
