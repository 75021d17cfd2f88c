"""Compiled code is not taken for that of other sources."""

import os
import time

from teleop import compile_cache


def test_each_state_of_the_sources_has_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setattr(compile_cache, "__file__", str(tmp_path / "teleop" / "compile_cache.py"))
    source = tmp_path / "estimator" / "law.py"
    source.parent.mkdir()

    folders = []
    for edit in range(6):
        source.write_text(f"slope = {edit}\n")
        os.utime(source, ns=(edit, edit))
        folders.append(compile_cache.choose())
        assert os.environ["NUMBA_CACHE_DIR"] == str(folders[-1])
        assert compile_cache.choose() == folders[-1]
        time.sleep(0.01)

    assert len(set(folders)) == 6
    kept = set(folders[0].parent.iterdir())
    assert folders[-1] in kept
    assert len(kept) == 1 + compile_cache.KEPT
