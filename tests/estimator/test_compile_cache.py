"""Compiled code is not taken from where others can write; finding a place for it never fails."""

import grp
import os
import pwd
import subprocess
import sys
import tempfile
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
    return compile_cache.choose_folder()


def no_home():
    raise RuntimeError("Could not determine home directory.")


def test_without_a_home_there_is_a_private_folder(unnamed, monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", no_home)
    folder = compile_cache.choose_folder()
    assert folder.parent == unnamed
    assert folder.stat().st_mode & 0o077 == 0


def open_to_all(place):
    place.chmod(0o777)
    return f"other users can write {place}; "


def open_to_a_group(place):
    if os.geteuid() != 0:
        pytest.skip("only root can give a folder to another group")
    os.chown(place, -1, 65534)
    place.chmod(0o770)
    return f"other users can write {place}; "


def of_somebody_else(place):
    if os.geteuid() != 0:
        pytest.skip("only root can give a folder away")
    os.chown(place, 65534, -1)
    return f"{place} belongs to another user; "


@pytest.mark.parametrize("spoil", [open_to_all, open_to_a_group, of_somebody_else])
@pytest.mark.parametrize("depth", [0, 1])
def test_code_is_not_loaded_from_where_others_may_write(unnamed, monkeypatch, capsys, depth, spoil):
    monkeypatch.setattr(Path, "home", no_home)
    good = chosen(monkeypatch)
    assert capsys.readouterr().err == ""
    says = spoil([good, good.parent][depth])
    folder = chosen(monkeypatch)
    assert folder == unnamed / f"tendon-teleop-{os.getuid()}"
    assert os.environ["NUMBA_CACHE_DIR"] == str(folder)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("WARNING: ")
    assert says in line


def test_a_group_of_this_user_alone_may_write(unnamed, monkeypatch, capsys):
    user = pwd.getpwuid(os.geteuid()).pw_name
    group = grp.struct_group((user, "x", os.getegid(), []))
    monkeypatch.setattr(compile_cache.grp, "getgrgid", lambda _: group)
    good = chosen(monkeypatch)
    good.parent.chmod(0o775)  # as a umask of 002 makes it
    assert chosen(monkeypatch) == good
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("spoil", [open_to_all, of_somebody_else])
def test_nor_from_there_if_the_user_names_it(unnamed, monkeypatch, capsys, spoil):
    (unnamed / "mine").mkdir()
    says = spoil(unnamed / "mine")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(unnamed / "mine"))
    assert compile_cache.choose_folder() == unnamed / "cache" / "tendon-teleop"
    assert says in capsys.readouterr().err


def test_without_a_folder_that_is_ours_nothing_is_cached(unnamed, monkeypatch, capsys):
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", no_home)
    taken = unnamed / f"tendon-teleop-{os.getuid()}"
    taken.mkdir()
    taken.chmod(0o777)
    assert chosen(monkeypatch) is None
    assert f"delete {taken}" in capsys.readouterr().err
    assert not os.environ["NUMBA_CACHE_DIR"]


def test_a_link_leads_to_the_folder_that_was_checked(unnamed, monkeypatch):
    (unnamed / "real").mkdir()
    (unnamed / "cache").symlink_to(unnamed / "real")
    assert chosen(monkeypatch) == unnamed / "real" / "tendon-teleop"


USES = """
import estimator.law
import numba
from estimator.compiled import jit_compile

@jit_compile
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


def test_its_folders_are_readable_by_their_owner_only(unnamed, monkeypatch):
    before = os.umask(0)
    try:
        folder = chosen(monkeypatch)
    finally:
        os.umask(before)
    assert folder.stat().st_mode & 0o777 == 0o700
