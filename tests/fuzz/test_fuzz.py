"""Whatever is given: no traceback, no hang, no file harmed, and one line that says what is wrong.

FUZZ_CASES=5000 FUZZ_SEED=7 in the environment draws other cases, and more.
"""

import os
import signal
import traceback
from pathlib import Path

import pytest

from teleop.cli import commands
from tests.fuzz.cases import Case, Fuzz
from tests.fuzz.running import HANG_CPU_S, HANG_S, check, contents, hang, load_all

CASES = int(os.environ.get("FUZZ_CASES", "300"))
SEED = int(os.environ.get("FUZZ_SEED", "1"))
CHUNK = 50


def run(case: Case, capfd):
    """Run a case; return the exit code and what was said on standard error."""
    if case.words[:1] == ["load"]:
        return load_all(Path(case.words[1])), capfd.readouterr().err
    try:
        code = commands.main(case.words)
    except SystemExit as end:  # argparse, after --help
        code = end.code
    return code, capfd.readouterr().err


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
            check(case.words, case.outputs, code, said, before, contents(folder))
        except BaseException as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            wrong.append(f"{number}: {case.words}: {error!r} at {place.filename}:{place.lineno}")
        finally:
            signal.alarm(0)
            signal.setitimer(signal.ITIMER_PROF, 0.0)
    assert not wrong, "\n".join(wrong)
