"""Real processes with keys of `teleop keys`, and certificates that must not take part."""

import json
import re
import subprocess
import sys

import pytest

from studies.testbed.processes import (
    OURS,
    START_S,
    find_free_ports,
    has_ended_well,
    wait_for_condition,
)
from teleop.cli import commands
from tests.system.namespaces import Network, require_namespaces

pytestmark = pytest.mark.slow

SESSION = "theatre-2"
HELD = "master.device.engage=[[0.5, 300]]", "master.device.engage_period=300"
TOGETHER = ("master", "slave", "supervisor", "recorder", "viewer")
DAY_S = 86_400.0


def issue(folder, out, *roles, session=SESSION):
    """Keys by the command, of one authority per folder."""
    home = folder / "authority"
    if not home.exists():
        assert commands.main(["keys", "init", str(home)]) == 0
    words = [word for role in roles for word in ("--role", role)]
    out_folder = folder / out
    assert commands.main(
        ["keys", "issue", str(home), "--session", session, "--out", str(out_folder), *words]
    ) == 0  # fmt: skip
    return out_folder


def test_a_run_with_keys_of_the_command(tmp_path, demo_config):
    keys = issue(tmp_path, "keys", *TOGETHER)
    ends = [f"127.0.0.1:{port}" for port in find_free_ports(2)]
    words = run_words(demo_config, tmp_path, keys, *ends)
    done = subprocess.run(
        [*words, "--duration", "4", "--record", str(tmp_path)],
        env=OURS, timeout=2 * START_S, check=False, capture_output=True, text=True,
    )  # fmt: skip
    assert has_ended_well(done.returncode, done.stderr), done.stdout + done.stderr
    assert "INSECURE" not in done.stdout
    summary = json.loads((tmp_path / "run.json").read_text())
    for side in ("master", "slave"):
        assert summary[side]["ticks_in"]["engaged"] > 1000
        assert summary[side]["rejected"] == dict.fromkeys(summary[side]["rejected"], 0)
    # without the certificate of one of its processes: one line, and nothing is left running
    (keys / f"{SESSION}.slave.pem").unlink()
    (tmp_path / "run.json").unlink()
    done = subprocess.run(
        words, env=OURS, timeout=START_S, check=False, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert f"no certificate of a slave of session '{SESSION}'" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def run_words(config, folder, keys, master, slave):
    words = [sys.executable, "-m", "teleop", "run", "--config", str(config), "--view", "none"]
    for text in (
        f"session={SESSION}", f"link.keys={keys}", f"link.master={master}", f"link.slave={slave}",
    ):  # fmt: skip
        words += ["--set", text]
    return [*words, "--json", str(folder / "run.json")]


def test_a_run_is_stopped_from_another_machine_by_who_may_and_by_nobody_else(tmp_path, demo_config):
    require_namespaces()
    keys = issue(tmp_path, "rig-keys", *TOGETHER)
    desk = issue(tmp_path, "desk-keys", "supervisor")
    wrong = issue(tmp_path, "wrong-keys", "viewer")
    (tmp_path / "elsewhere").mkdir()
    strangers = issue(tmp_path / "elsewhere", "keys", "supervisor")
    with Network(("rig", "desk"), (("rig", "desk"),)) as network:
        ends = [f"{network.address['rig', 'desk']}:{port}" for port in (7451, 7452)]
        words = run_words(demo_config, tmp_path, keys, *ends)
        switch = [word for text in HELD for word in ("--set", text)]
        network.start("rig", [*words, *switch], tmp_path / "run.log")

        def text():
            return (tmp_path / "run.log").read_text()

        def stop(keys, name):
            log = tmp_path / f"{name}.log"
            command = [sys.executable, "-m", "teleop", "stop", "--config", str(demo_config)]
            for item in (
                f"session={SESSION}", f"link.keys={keys}",
                f"link.master={ends[0]}", f"link.slave={ends[1]}",
            ):  # fmt: skip
                command += ["--set", item]
            code = network.start("desk", command, log).wait(60.0)
            return code, log.read_text()

        assert wait_for_condition(lambda: re.search(r"\[slave\].*ngaged", text()), 2 * START_S), (
            text()
        )
        for folder, name in ((wrong, "wrong"), (strangers, "stranger")):
            code, said = stop(folder, name)
            assert code != 0, said
            assert len(said.splitlines()) == 1
        assert "stopped" not in text().lower()
        code, said = stop(desk, "desk")
        assert code == 0, said
        assert wait_for_condition(lambda: "stopped" in text().lower(), 10.0), text()
