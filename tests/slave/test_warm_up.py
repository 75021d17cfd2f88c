"""Nothing is compiled between a reading and a write: the newest positions would be too old."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    "program",
    [
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("check", "calibrate")),
        *("session", "extensions"),
    ],
)
def test_nothing_is_called_compiled_for_the_first_time_after_the_warm_up(program):
    command = [sys.executable, "-m", "tests.slave.first_calls", program]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "first calls:"
