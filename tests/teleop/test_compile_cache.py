"""Compiled code is not taken for that of other sources, and finding a place for it never fails."""

import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import pytest

from teleop import compile_cache


@pytest.fixture
def unnamed(tmp_path, monkeypatch):
    """Nobody has named a folder, and there are a cache folder and a temporary one."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def chosen(monkeypatch):
    """What a new process would choose."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    return compile_cache.choose()


def test_each_state_of_the_sources_has_a_folder_of_its_own(unnamed, monkeypatch):
    monkeypatch.setattr(compile_cache, "__file__", str(unnamed / "teleop" / "compile_cache.py"))
    source = unnamed / "estimator" / "law.py"
    source.parent.mkdir()

    folders = []
    for edit in range(6):
        source.write_text(f"slope = {edit}\n")
        os.utime(source, ns=(edit, edit))
        folders.append(chosen(monkeypatch))
        assert os.environ["NUMBA_CACHE_DIR"] == str(folders[-1])
        assert chosen(monkeypatch) == folders[-1]
        time.sleep(0.01)

    assert len(set(folders)) == 6
    kept = set(folders[0].parent.iterdir())
    assert folders[-1] in kept
    assert len(kept) == 1 + compile_cache.KEPT


def test_a_folder_named_by_the_user_is_left_alone(unnamed, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(unnamed / "mine"))
    assert compile_cache.choose() == unnamed / "mine"
    assert os.environ["NUMBA_CACHE_DIR"] == str(unnamed / "mine")
    assert list(unnamed.iterdir()) == []


def no_home():
    raise RuntimeError("Could not determine home directory.")


def test_without_a_home_there_is_a_private_folder(unnamed, monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", no_home)
    folder = compile_cache.choose()
    assert folder.parent.parent == unnamed
    assert folder.parent.stat().st_mode & 0o077 == 0


def test_code_is_not_loaded_from_where_others_may_write(unnamed, monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", no_home)
    taken = unnamed / f"tendon-teleop-{os.getuid()}"
    taken.mkdir()
    taken.chmod(0o777)
    assert compile_cache.choose() is None
    assert os.environ["NUMBA_CACHE_DIR"] == ""


def test_a_cache_folder_that_cannot_be_made_is_passed_over(unnamed, monkeypatch):
    (unnamed / "cache").write_text("a file")
    monkeypatch.setattr(Path, "home", no_home)
    assert compile_cache.choose().parent.name.startswith("tendon-teleop-")


COMPILES = """
import numba

from teleop.compile_cache import announced

@numba.njit(cache=True)
def add(a, b):
    return a + b

with announced("a sum", 12.3):
    add(1, 2)
    add(1.0, 2.0)
"""


def test_compiling_is_announced_in_one_line_and_a_second_run_has_nothing_to_compile(tmp_path):
    script = tmp_path / "compiles.py"
    script.write_text(COMPILES)
    root = Path(__file__).parents[2]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(root)}
    runs = [
        subprocess.run(
            [sys.executable, script], capture_output=True, text=True, check=False, env=environment
        )
        for _ in range(2)
    ]
    assert [run.stderr for run in runs] == ["", ""]
    line = "compiling a sum (once on this machine; about 12 s) ...\n"
    assert [run.stdout for run in runs] == [line, ""]


COMPILES_BESIDE = """
from functools import partial

import numba

from teleop.compile_cache import announced

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
    with announced("a sum", 12.3, partial(compile_of, float)):
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


def test_another_process_compiles_only_where_nothing_is_compiled_yet(unnamed, monkeypatch):
    caches = unnamed / "mine"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(caches))
    mark = partial(Path.touch, unnamed / "done")
    with compile_cache.compiling_beside(mark):
        deadline = time.monotonic() + 30.0
        while not (unnamed / "done").exists() and time.monotonic() < deadline:
            time.sleep(0.02)
    assert (unnamed / "done").exists()

    (unnamed / "done").unlink()
    (caches / "slave_0").mkdir(parents=True)
    (caches / "slave_0" / "loop.nbi").touch()
    with compile_cache.compiling_beside(mark):
        time.sleep(1.0)
    assert not (unnamed / "done").exists()


def test_the_other_process_ends_with_the_work_beside_it(unnamed, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(unnamed / "mine"))
    with compile_cache.compiling_beside(partial(time.sleep, 60.0)):
        (helper,) = multiprocessing.active_children()
    assert not helper.is_alive()
