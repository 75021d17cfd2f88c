"""Compiling is announced, shared between two processes, and done once."""

import os
import subprocess
import sys
from pathlib import Path

COMPILES_BESIDE = """
from functools import partial

import numba

from teleop.runtime.compiling import announce_compilation

def compile_of(kind):
    product(kind(2), kind(3))
    print(len(product.stats.cache_misses), "compiled here")

@numba.njit(cache=True)
def add(a, b):
    return a + b

@numba.njit(cache=True)
def product(a, b):
    return a * b

if __name__ == "__main__":
    with announce_compilation("a sum", 12.3, partial(compile_of, float)):
        add(1, 2)
"""


def test_what_is_compiled_beside_is_in_the_cache_when_it_is_called(tmp_path):
    """It runs in another process only if something is to be compiled, and always in this one."""
    script = tmp_path / "compiles.py"
    script.write_text(COMPILES_BESIDE)
    root = Path(__file__).parents[2]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(root)}
    runs = [
        subprocess.run(
            [sys.executable, script], capture_output=True, text=True, check=False, env=environment
        )
        for _ in range(2)
    ]
    assert [run.stderr for run in runs] == ["", ""]
    line = "compiling a sum (once on this machine; about 12 s) ..."
    there, here = "1 compiled here", "0 compiled here"
    assert [run.stdout.splitlines() for run in runs] == [[line, there, here], [here]]
