"""Start modules of ours as child processes, and end children."""

import os
import subprocess
from collections.abc import Mapping
from typing import Any

from teleop.runtime.process import SUPERVISED_VARIABLE, build_module_command

NOTHING: Mapping[str, str] = {}


def start_module(
    module: str,
    *words: str,
    environment: Mapping[str, str] = NOTHING,
    is_supervised: bool = False,
    gets_interrupts: bool = False,
    **options: Any,
) -> "subprocess.Popen[Any]":
    """Start a module of ours with some words of a command line in a process of its own.

    The `environment` is added to that of this process. A child that `is_supervised`, which this
    process speaks for, ends when this one dies (`process.is_supervised`). Ctrl-C in the terminal
    reaches one that `gets_interrupts`; this process has to end any other. The `options` are of
    `subprocess.Popen`; without others the child has no input. `OSError` if it cannot be started.
    """
    supervised = {SUPERVISED_VARIABLE: str(os.getpid())} if is_supervised else {}
    return subprocess.Popen(
        [*build_module_command(module), *words],
        env={**os.environ, **supervised, **environment},
        start_new_session=not gets_interrupts,
        **{"stdin": subprocess.DEVNULL, **options},
    )


def end_process(process: "subprocess.Popen[Any]", patience_s: float) -> bool:
    """Tell a child to end, and kill it if it has not within `patience_s` [s].

    Returns whether it ended without that. One that has ended is left alone.
    """
    process.terminate()
    try:
        process.wait(patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return False
    return True
