"""Temporary folders of killed processes."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from teleop.runtime.scratch_folder import ScratchFolder


def test_scratch_folders_of_killed_processes_are_removed_and_no_others(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    program = (
        "import signal, os; from teleop.runtime.scratch_folder import ScratchFolder\n"
        "folder = ScratchFolder(); print(folder.name, flush=True); signal.pause()"
    )
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    words = [sys.executable, "-c", program]
    with subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, text=True) as process:
        used = Path(process.stdout.readline().strip())
        young, other = tmp_path / "teleop-run-young", tmp_path / "teleop-tests-other"
        for folder in (young, other):
            folder.mkdir()
        for folder in (used, other):
            os.utime(folder, (0, 0))
        with ScratchFolder() as mine:
            assert {used, young, other, Path(mine)} == set(tmp_path.iterdir())
        assert {used, young, other} == set(tmp_path.iterdir())
        process.kill()
    ScratchFolder().cleanup()
    assert {young, other} == set(tmp_path.iterdir())
