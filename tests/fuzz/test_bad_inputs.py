"""Bad Parquet, recordings and bags are refused: one line, exit code 2, in bounded memory.

BAD_INPUTS_SEED=7 in the environment draws others.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SEED = int(os.environ.get("BAD_INPUTS_SEED", "1"))
FEW, ALL = 20, 1000
ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("first", "end"),
    [(0, FEW), *(pytest.param(k, k + 100, marks=pytest.mark.slow) for k in range(0, ALL, 100))],
)
def test_bad_inputs_are_refused_in_a_line_and_in_bounded_memory(first, end, tmp_path):
    words = ["-m", "tests.fuzz.bad_inputs", SEED, first, end, tmp_path]
    done = subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=1800,
        check=False,
    )
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert answers[-1:] == [{"ran": end - first}], done.stderr[-2000:]
    assert answers[:-1] == []
