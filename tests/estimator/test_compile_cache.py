"""Compiled code is not taken for that of other sources, and finding a place for it never fails."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from estimator import compile_cache


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
    monkeypatch.setattr(compile_cache, "__file__", str(unnamed / "estimator" / "compile_cache.py"))
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
    assert set(folders[0].parent.iterdir()) == set(folders)  # other processes may use them
    unused_s = time.time() - 1.1 * compile_cache.IN_USE_S
    for age, folder in enumerate(reversed(folders)):
        os.utime(folder, (unused_s - age, unused_s - age))
    assert chosen(monkeypatch) == folders[-1]
    assert set(folders[0].parent.iterdir()) == set(folders[-1 - compile_cache.KEPT :])


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


USES = """
import estimator.law
import numba
from estimator.compiled import compiled

@compiled
def add(a, b):
    return a + b

add(1, 2)
print(add.stats.cache_path)
"""


@pytest.mark.parametrize("first", ["", "import numba\n"])
def test_a_program_of_the_users_caches_there_too(first, unnamed):
    script = unnamed / "uses.py"
    script.write_text(first + USES)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    ran = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, check=True, env=environment
    )
    assert Path(ran.stdout.strip()).is_relative_to(unnamed / "cache" / "tendon-teleop")
