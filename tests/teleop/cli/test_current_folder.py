"""No process of ours imports from the folder where it is started: any file may lie there."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.root import ROOT
from tests.system.processes import OURS, free_ports

TELEOP = Path(sys.executable).with_name("teleop")
PACKAGES = ("estimator", "teleop", "master", "slave")
STARTERS = {"teleop/runtime/process.py", "master/devices/hid/watchdog.py"}  # that know how
IN_PARALLEL = """
import math
import sys
import teleop.cli.doctor
from teleop import __main__
from teleop.runtime.parallel import parallel_map

def work(args):
    print(list(parallel_map(math.sqrt, [4.0, 9.0], 2)))
    return 0

if __name__ == "__main__":
    teleop.cli.doctor.main = work
    sys.argv[1:] = ["doctor"]
    sys.exit(__main__.main())
"""


@pytest.fixture
def crowded(tmp_path):
    """A folder with a file of the name of each module that anybody could import."""
    folder = tmp_path / "crowded"
    folder.mkdir()
    for name in {*PACKAGES, "numpy", "numba", "scipy", "zenoh", "yaml", *sys.stdlib_module_names}:
        (folder / f"{name}.py").write_text("raise SystemExit('imported ' + __file__)\n")
    return folder


def test_a_session_imports_nothing_from_the_current_folder(crowded, demo_config):
    master, slave = free_ports(2)
    words = ["--config", demo_config, "--duration", "1", "--view", "none", "--record", "recordings"]
    link = ["--set", f"link.master=127.0.0.1:{master}", "--set", f"link.slave=127.0.0.1:{slave}"]
    ended = subprocess.run(
        [TELEOP, "run", *words, *link],
        cwd=crowded,
        env=OURS,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "imported" not in ended.stdout + ended.stderr
    assert "command to force" in ended.stdout, ended.stdout + ended.stderr


def test_a_pool_of_processes_imports_nothing_from_the_current_folder(crowded, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(IN_PARALLEL)
    ended = subprocess.run(
        [sys.executable, program],
        cwd=crowded,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,  # a pool replaces processes that fail without end
    )
    assert (ended.stdout, ended.stderr, ended.returncode) == ("[2.0, 3.0]\n", "", 0)


def test_as_a_module_the_program_imports_no_other_one_from_the_current_folder(tmp_path):
    for name in ("estimator", "master", "slave", "numpy", "yaml"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('imported ' + __file__)\n")
    words = [sys.executable, "-m", "teleop", "estimate", "no.csv", "--fit"]
    ended = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.stderr.startswith("teleop: no.csv: ")
    assert ended.returncode == 2


def test_nothing_else_starts_python():
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            starts = any(
                isinstance(node, ast.Attribute) and ast.unparse(node) == "sys.executable"
                for node in ast.walk(ast.parse(path.read_text()))
            )
            assert not starts or str(path.relative_to(ROOT)) in STARTERS, path
