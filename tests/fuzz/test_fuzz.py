"""Whatever is given: no traceback, no hang, no file harmed, and one line that says what is wrong.

FUZZ_CASES=5000 FUZZ_SEED=7 in the environment draws other cases, and more.
"""

import importlib
import os
import signal
import sys
import traceback
from pathlib import Path

import pytest

from teleop.app import cli
from teleop.app.launch.command import SECTIONS
from teleop.config import load
from teleop.errors import UsageError
from teleop.run_config import RunConfig
from tests.fuzz.cases import Case, Fuzz

CASES = int(os.environ.get("FUZZ_CASES", "300"))
SEED = int(os.environ.get("FUZZ_SEED", "1"))
CHUNK = 50
HANG_CPU_S, HANG_S = 20.0, 300  # of processor time, and in all; a case takes 20 ms


def hang(*_):
    raise AssertionError("it hangs")


def contents(folder):
    """Return path -> bytes of all files below a folder, None for a folder."""
    return {
        path: None if path.is_dir() else path.read_bytes() for path in sorted(folder.rglob("*"))
    }


def run(case: Case, capfd):
    """Run a case; return the exit code and what was said on standard error."""
    if case.words[:1] == ["load"]:
        return load_all(Path(case.words[1])), capfd.readouterr().err
    try:
        code = cli.main(case.words)
    except SystemExit as end:  # argparse, after --help
        code = end.code
    return code, capfd.readouterr().err


def load_all(path):
    """Read a config as `teleop run` does; return the exit code."""
    try:
        load(path, RunConfig, None, ())
        for section, (module, name) in SECTIONS.items():
            load(path, getattr(importlib.import_module(module), name), section, ())
    except UsageError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


@pytest.mark.parametrize("chunk", range(-(-CASES // CHUNK)))
def test_anything_given_is_answered_in_a_line_and_nothing_is_harmed(
    chunk, tmp_path, capfd, monkeypatch
):
    signal.signal(signal.SIGALRM, hang)
    signal.signal(signal.SIGPROF, hang)
    wrong = []
    for number in range(chunk * CHUNK, min((chunk + 1) * CHUNK, CASES)):
        folder = tmp_path / str(number)
        folder.mkdir()
        monkeypatch.chdir(folder)
        case = Fuzz(SEED * 1_000_000 + number, folder).draw()
        before = contents(folder)
        signal.alarm(HANG_S)
        signal.setitimer(signal.ITIMER_PROF, HANG_CPU_S)
        try:
            code, said = run(case, capfd)
            check(case, code, said, before, contents(folder))
        except BaseException as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            wrong.append(f"{number}: {case.words}: {error!r} at {place.filename}:{place.lineno}")
        finally:
            signal.alarm(0)
            signal.setitimer(signal.ITIMER_PROF, 0.0)
    assert not wrong, "\n".join(wrong)


def check(case, code, said, before, after):
    """Check what a case has left."""
    assert code in (0, 1, 2), code
    assert "Traceback" not in said
    lines = [line for line in said.splitlines() if not line.endswith(" ...")]  # but progress
    if code:
        assert len(lines) <= 1, said
    forced = "--force" in case.words
    for path, data in before.items():
        if not (forced and path in case.outputs):
            assert after.get(path, b"gone") == data, f"harmed: {path}"
    for path in set(after) - set(before):
        allowed = [out for out in case.outputs if path == out or out in path.parents]
        assert allowed, f"left behind: {path}"
        assert code == 0, f"left behind: {path}"
