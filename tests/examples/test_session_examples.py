"""The examples that start a session of their own; `.ci/run` runs them from the wheel as well."""

import re

import pytest

from tests.examples.test_examples import run
from tests.system.test_run import run as run_session

pytestmark = pytest.mark.slow


def test_a_session_from_python_reads_the_force(tmp_path):
    said = run(tmp_path, "session.py")
    assert 1.0 < float(re.search(r"was ([\d.]+) N", said)[1]) < 30.0


def test_a_recording_is_read_as_columns(demo_config, tmp_path):
    words = ["--duration", "3", "--view", "none", "--record", str(tmp_path)]
    code, out, err = run_session(demo_config, tmp_path, *words)
    assert code == 0 or (code == 1 and "messages are missing" in err), out + err  # a busy machine
    (recording,) = tmp_path.glob("*.mcap")
    said = run(tmp_path, "read_recording.py", recording)
    assert int(re.search(r"engaged in (\d+)%", said)[1]) > 10
    assert "force at the tip" in said
