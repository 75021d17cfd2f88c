"""No process of ours imports from the folder where it is started: any file may lie there."""

import ast
import subprocess
import sys

import pytest

from tests.root import ROOT

PACKAGES = ("estimator", "teleop", "master", "slave")
STARTERS = {"teleop/runtime/process.py", "master/devices/hid/watchdog.py"}  # that know how
IN_PARALLEL = """
import math
import sys
from multiprocessing import get_context
import teleop.cli.doctor
from teleop import __main__

def work(args):
    with get_context("spawn").Pool(2) as pool:
        print(pool.map(math.sqrt, [4.0, 9.0]))
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


def test_nothing_else_starts_python():
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text()
            starts = "sys.executable" in text and any(
                isinstance(node, ast.Attribute) and ast.unparse(node) == "sys.executable"
                for node in ast.walk(ast.parse(text))
            )
            assert not starts or str(path.relative_to(ROOT)) in STARTERS, path
