"""Compiling is announced, shared between two processes, and done once."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from teleop.runtime import compiling
from teleop.runtime.compiling import compile_in_parallel
from tests.root import ROOT

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


WORK = """
import time
from pathlib import Path

def mark(seconds=60.0):
    Path({done!r}).touch()
    time.sleep(seconds)

def end():
    mark(0.0)
"""


@pytest.fixture
def done(tmp_path, monkeypatch):
    """The file that the work of another process leaves."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "mine"))
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}:{tmp_path}")
    done = tmp_path / "done"
    (tmp_path / "work.py").write_text(WORK.format(done=str(done)))
    return done


def await_file(path, seconds):
    deadline = time.monotonic() + seconds
    while not path.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    return path.exists()


def test_another_process_compiles_where_nothing_is_compiled_yet_and_ends_with_it(done):
    with compile_in_parallel("work:mark"):
        assert await_file(done, 30.0)
        (helper,) = find_children("work:mark")
    assert not Path(f"/proc/{helper}").exists()


def test_no_process_compiles_what_one_has_compiled_until_a_source_changes(done, monkeypatch):
    for sources in ("before", "after"):
        monkeypatch.setattr(compiling, "_hash_sources", lambda: sources)  # noqa: B023
        with compile_in_parallel("work:end"):
            assert await_file(done.parent / "mine" / f"work.end-{sources}", 30.0)
        with compile_in_parallel("work:end"):
            assert find_children("work:end") == []


def find_children(word):
    """Return the processes that this one has started with a word of the command line."""
    mine = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
    return [pid for pid in mine if word in Path(f"/proc/{pid}/cmdline").read_text().split("\0")]
