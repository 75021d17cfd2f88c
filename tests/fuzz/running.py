"""How a case of the fuzzers is run, and what it is judged by."""

import contextlib
import io
import signal
import sys
import traceback
from pathlib import Path

from teleop.cli import commands
from teleop.config.loading import load
from teleop.errors import UsageError
from teleop.launch.config import SessionConfig

HANG_CPU_S, HANG_S = 20.0, 900  # of processor time, and in all; a case takes 20 ms


def judge(case, folder):
    """Run a case whose files are in a folder; return what is wrong with its answer, or None."""
    before = contents(folder)
    for number in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(number, hang)
    signal.alarm(HANG_S)
    signal.setitimer(signal.ITIMER_PROF, HANG_CPU_S)
    try:
        code, said = run(case.words)
        check(case, code, said, before, contents(folder))
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{folder.name}: {case.words}: {error!r} at {place.filename}:{place.lineno}"
    finally:
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return None


def hang(*_):
    raise AssertionError("it hangs")


def run(words):
    """Return the exit code of a command line, and what it said on standard error."""
    with (
        contextlib.redirect_stderr(io.StringIO()) as said,
        contextlib.redirect_stdout(io.StringIO()),
    ):
        try:
            code = load_all(Path(words[1])) if words[:1] == ["load"] else commands.main(words)
        except SystemExit as end:  # argparse, after --help
            code = end.code
    return code, said.getvalue()


def contents(folder):
    """Return path -> bytes of all files below a folder, None for what is no file."""
    return {
        path: path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))
    }


def load_all(path):
    """Read a config as `teleop run` does; return the exit code."""
    try:
        load(path, SessionConfig, None)
    except UsageError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def check(case, code, said, before, after):
    """Check the answer to a command line, and what it has left."""
    assert code == 2 or (not case.refused and code in (0, 1)), f"exit code {code}: {said}"
    assert "Traceback" not in said
    lines = said.splitlines()
    lines = [one for one in lines if not (one.endswith(" ...") or one.startswith("WARNING: "))]
    if code:
        assert len(lines) == 1, said
    forced = "--force" in case.words
    for path, data in before.items():
        if not (forced and path in case.outputs):
            assert after.get(path, b"gone") == data, f"harmed: {path}"
    for path in set(after) - set(before):
        allowed = [out for out in case.outputs if path == out or out in path.parents]
        assert allowed, f"left behind: {path}"
        assert code == 0, f"left behind: {path}"
