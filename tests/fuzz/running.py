"""What a case of the fuzzers is judged by."""

import sys

from teleop.config.loading import load
from teleop.errors import UsageError
from teleop.launch.config import SessionConfig

HANG_CPU_S, HANG_S = 20.0, 900  # of processor time, and in all; a case takes 20 ms


def hang(*_):
    raise AssertionError("it hangs")


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


def check(words, outputs, code, said, before, after):
    """Check the answer to a command line, and what it has left."""
    assert code in (0, 1, 2), code
    assert "Traceback" not in said
    lines = said.splitlines()
    lines = [one for one in lines if not (one.endswith(" ...") or one.startswith("WARNING: "))]
    if code:
        assert len(lines) == 1, said
    forced = "--force" in words
    for path, data in before.items():
        if not (forced and path in outputs):
            assert after.get(path, b"gone") == data, f"harmed: {path}"
    for path in set(after) - set(before):
        allowed = [out for out in outputs if path == out or out in path.parents]
        assert allowed, f"left behind: {path}"
        assert code == 0, f"left behind: {path}"
