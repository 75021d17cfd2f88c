"""The first process of a virtual machine: prepare it, run the checks, switch off.

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
from typing import Any, TextIO

from slave.drivers.driver import DriverFault
from studies.kernel.image import MODULES
from studies.kernel.judge import WrongError

_RESTART = 0x01234567
_FINIT_MODULE = 313  # of x86-64
_RESULTS = Path("/dev/ttyS1")
_LIBC = ctypes.CDLL(None, use_errno=True)


def run_checks(checks: Callable[[Callable[..., None]], None]) -> None:
    """Run the checks, which are given a function that says a result. Never returns."""
    try:
        _prepare()
        with _RESULTS.open("w") as results:
            say = partial(_say, results)
            say(check="boot", figures={"ready after": f"{time.monotonic():.1f} s"})
            checks(say)
            say(check="end", figures={"after": f"{time.monotonic():.1f} s"})
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os.sync()
        _LIBC.reboot(_RESTART)


def try_check(say: Callable[..., None], device: str, check: Callable[..., Any], *what: Any) -> bool:
    """Run one check on a device, and say its figures or its trouble; return whether it passed."""
    try:
        figures = check(*what)
    except (WrongError, DriverFault) as error:
        said = {"trouble": str(error)}
    except Exception as error:  # whatever it is, the other checks still run
        traceback.print_exc()
        said = {"trouble": repr(error)}
    else:
        said = {"figures": figures}
    say(device=device, check=check.__name__, **said)
    return "figures" in said


def read_words(name: str) -> list[str]:
    """Return what the kernel's command line gives for a name, as in devices=first,second."""
    given = Path("/proc/cmdline").read_text().split()
    text = next((word for word in given if word.startswith(f"{name}=")), "=")
    return text.partition("=")[2].split(",")


def _prepare() -> None:
    for kind, place in (("proc", "/proc"), ("sysfs", "/sys"), ("devtmpfs", "/dev")):
        if _LIBC.mount(kind.encode(), place.encode(), kind.encode(), 0, None) != 0:
            raise OSError(ctypes.get_errno(), f"mount {place}")
    for module in sorted(Path(MODULES).iterdir()):
        with module.open("rb") as file:
            if _LIBC.syscall(_FINIT_MODULE, file.fileno(), b"", 0) != 0:
                raise OSError(ctypes.get_errno(), f"module {module}")


def _say(results: TextIO, **what: object) -> None:
    results.write(json.dumps(what) + "\n")
    results.flush()
