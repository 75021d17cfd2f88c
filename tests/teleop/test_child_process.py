import os
import subprocess
import sys

import pytest

from teleop.runtime.child_process import end_process, start_module
from teleop.runtime.process import SUPERVISED_VARIABLE

TELL = """
import os, sys
own_session = os.getsid(0) == os.getpid()
print(sys.argv[1:], os.environ.get("TELEOP_SUPERVISED"), os.environ.get("EXTRA"), own_session)
print(repr(sys.stdin.read()))
"""


@pytest.mark.parametrize(("is_supervised", "gets_interrupts"), [(True, False), (False, True)])
def test_a_module_is_given_its_words_and_no_more_than_was_asked(
    tmp_path, monkeypatch, is_supervised, gets_interrupts
):
    (tmp_path / "teller.py").write_text(TELL)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.delenv(SUPERVISED_VARIABLE, raising=False)
    child = start_module(
        "teller",
        "one",
        "two",
        environment={"EXTRA": "more"},
        is_supervised=is_supervised,
        gets_interrupts=gets_interrupts,
        stdout=subprocess.PIPE,
        text=True,
    )
    told, read = child.communicate()[0].splitlines()
    launcher = os.getpid() if is_supervised else None
    assert told == f"['one', 'two'] {launcher} more {not gets_interrupts}"
    assert read == "''"


WAIT = "import signal; print('here', flush=True); signal.pause()"
DEAF = f"import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); {WAIT}; signal.pause()"


@pytest.mark.parametrize(
    ("code", "patience_s", "by_itself"), [(WAIT, 20.0, True), (DEAF, 0.1, False)]
)
def test_a_child_ends_by_itself_or_is_killed(code, patience_s, by_itself):
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    with child:
        assert child.stdout.readline() == "here\n"
        assert end_process(child, patience_s) == by_itself
        assert child.returncode == (-15 if by_itself else -9)
        assert end_process(child, patience_s)  # which has ended
