"""Whatever is given: no traceback, no hang, no file harmed, and one line that says what is wrong.

FUZZ_CASES=5000 FUZZ_SEED=7 in the environment draws other cases, and more.
"""

import os

import pytest

from tests.fuzz.cases import Fuzz
from tests.fuzz.running import judge

CASES = int(os.environ.get("FUZZ_CASES", "300"))
SEED = int(os.environ.get("FUZZ_SEED", "1"))
CHUNK = 50


@pytest.mark.parametrize("chunk", range(-(-CASES // CHUNK)))
def test_anything_given_is_answered_in_a_line_and_nothing_is_harmed(chunk, tmp_path, monkeypatch):
    wrong = []
    for number in range(chunk * CHUNK, min((chunk + 1) * CHUNK, CASES)):
        folder = tmp_path / str(number)
        folder.mkdir()
        monkeypatch.chdir(folder)
        wrong.append(judge(Fuzz(SEED * 1_000_000 + number, folder).draw(), folder))
    assert not any(wrong), "\n".join(filter(None, wrong))
