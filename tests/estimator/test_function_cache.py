"""A function is compiled anew if what it names has changed, in whichever file, and else is not."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from estimator import function_cache
from estimator.function_cache import KEPT_S, prune
from tests.root import ROOT

FILES = {
    "limits": "UPPER = 3.0\nOTHER = 1.0\n",
    "pairs": "",
    "records": """
from typing import NamedTuple
class Pair(NamedTuple):
    a: float
    b: float
""",
    "inner": """
import limits
from estimator.compiled import jit_compile
@jit_compile
def clip(x):
    if x < -10.0:
        raise ValueError("too low")
    return min(x, limits.UPPER)
""",
    "outer": """
from inner import clip
from estimator.compiled import jit_compile
from records import Pair
@jit_compile
def add(x):
    pair = Pair(clip(x), 1.0)
    return pair.a + pair.b
@jit_compile
def double(pair):
    return 2.0 * pair.a
""",
    "program": """
from inner import clip
from outer import add, double
from records import Pair
versions = add, double, add.part, clip.part
print(add(5.0), double(Pair(5.0, 1.0)), *(len(f.stats.cache_hits) for f in versions))
try:
    add(-11.0)
except ValueError as error:
    print(error)
""",
}


@pytest.fixture
def start(tmp_path):
    """Write the files, changed by `edits`, and start the program."""

    def start(**edits):
        for name, text in FILES.items():
            old, new = edits.get(name, ("", ""))
            assert old in text
            (tmp_path / f"{name}.py").write_text(text.replace(old, new, 1))
        environment = {
            "PYTHONPATH": f"{ROOT}:{tmp_path}",
            "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
            "PYTHONDONTWRITEBYTECODE": "1",  # two states of a file within one second
        }
        command = [sys.executable, tmp_path / "program.py"]
        return subprocess.Popen(
            command, env=os.environ | environment, stdout=subprocess.PIPE, text=True
        )

    return start


@pytest.fixture
def run(start):
    """Return a function that runs the program: results, loaded versions, error."""
    return lambda **edits: start(**edits).communicate()[0].splitlines()


def test_only_what_a_change_concerns_or_what_is_damaged_is_compiled_anew(run, tmp_path):
    assert run() == ["4.0 10.0 0 0 0 0", "too low"]
    for path in filter(Path.is_file, (tmp_path / "cache").iterdir()):
        path.write_bytes(b"no pickle")
    assert run() == ["4.0 10.0 0 0 0 0", "too low"]
    moved = {"outer": ("\nfrom", '\n"""Text."""\n\nfrom'), "limits": ("OTHER = 1.0", "OTHER = 2.0")}
    assert run(**moved) == ["4.0 10.0 1 1 0 0", "too low"]  # a callee is a part of its file
    assert run(outer=("pair.a +", "pair.a -")) == ["2.0 10.0 0 1 0 1", "too low"]
    # of a callee in another file, a constant in a third one, and the order of a tuple's fields
    assert run(inner=("min(", "max(")) == ["6.0 10.0 0 1 0 0", "too low"]
    assert run(limits=("3.0", "2.0")) == ["3.0 10.0 0 1 0 0", "too low"]
    swapped = {
        "records": ("a: float\n    b", "b: float\n    a"),
        "outer": ("pair.a +", "2.0 * pair.a +"),
    }
    assert run(**swapped) == ["5.0 2.0 0 0 0 1", "too low"]


def test_two_processes_at_once_compile_each_function_once(start, tmp_path):
    both = [start(), start()]
    loaded = [program.communicate()[0].split()[2:4] for program in both]
    assert [int(first) + int(second) for first, second in zip(*loaded, strict=True)] == [1, 1]
    assert not list((tmp_path / "cache").glob("*.lock"))


def test_who_compiles_but_hangs_is_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(function_cache, "CLAIM_S", 0.1)
    first = function_cache._claim(tmp_path / "function")
    function_cache._claim(tmp_path / "function").close()
    first.close()


@pytest.mark.slow
def test_a_type_that_has_moved_to_another_file_is_compiled_again(run):
    first = run()
    imports = ("from records", "from pairs")
    moved = {"pairs": ("", FILES["records"]), "records": (FILES["records"], "")}
    assert run(**moved, outer=imports, program=imports)[0].startswith("4.0 10.0 ")
    assert first[0].startswith("4.0 10.0 ")


def test_what_was_not_used_for_long_is_deleted(tmp_path):
    for name, age_s in (("old", KEPT_S + 60.0), ("new", KEPT_S - 60.0), ("folder", 2.0 * KEPT_S)):
        path = tmp_path / name
        path.mkdir() if name == "folder" else path.touch()
        os.utime(path, (time.time() - age_s,) * 2)
    prune(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["new"]


def test_what_cannot_be_compiled_is_not_held_from_others(run, tmp_path):
    program = FILES["program"]
    failing = (
        "from outer import add\ntry:\n    add('text')\nexcept Exception as e:\n    print(type(e))\n"
    )
    (tmp_path / "cache").mkdir()
    done = run(
        program=(program, failing + "import os\nprint(os.listdir(os.environ['NUMBA_CACHE_DIR']))")
    )
    assert done[0] == "<class 'numba.core.errors.TypingError'>"
    assert ".lock" not in done[1]
