"""Two whole sessions on one machine, neither told anything: nothing of one reaches the other."""

import json
import subprocess
import sys

import pytest

from studies.testbed.processes import OURS, START_S, has_ended_well


@pytest.mark.slow
def test_two_runs_side_by_side_share_nothing(tmp_path, demo_config):
    words = [sys.executable, "-m", "teleop", "run", "--config", str(demo_config)]
    words += ["--view", "none", "--duration", "5"]
    words += ["--set", "rate_hz=250"]  # two sessions at 1 kHz are more than two cores carry
    runs = [
        subprocess.Popen(
            [*words, "--json", str(tmp_path / f"{i}.json"), "--record", str(tmp_path / str(i))],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=OURS | {"XDG_RUNTIME_DIR": str(tmp_path)},
        )
        for i in range(2)
    ]
    try:
        texts = [run.communicate(timeout=2 * START_S)[0] for run in runs]
    finally:
        for run in runs:
            run.kill()
    for text, run in zip(texts, runs, strict=True):
        assert has_ended_well(run.returncode, text), text
    names = [text.split(".")[0].removeprefix("Session ") for text in texts]
    assert len(set(names)) == 2
    for i, name in enumerate(names):
        summary = json.loads((tmp_path / f"{i}.json").read_text())
        for side in ("master", "slave"):
            assert summary[side]["ticks_in"]["engaged"] > 500
            assert summary[side]["rejected"] == dict.fromkeys(summary[side]["rejected"], 0)
        assert name in summary["record"]["file"]
    assert not list((tmp_path / "tendon-teleop").glob("*"))
