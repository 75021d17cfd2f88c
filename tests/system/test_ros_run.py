"""`teleop run` with ROS: the child it starts, and what it refuses before anything starts."""

import json
import subprocess
import sys

import pytest

from studies.testbed.processes import OURS, START_S, find_free_ports
from teleop.cli import commands
from tests.root import ROOT
from tests.teleop.ros.peers import Heard, peer, router


def test_a_router_on_a_port_of_the_link_is_refused_before_anything_starts(capsys):
    words = ["run", "--view", "none", "--set", "ros.start=true"]
    assert commands.main([*words, "--set", "link.slave=127.0.0.1:7447"]) == 2
    assert "link.slave has this port" in capsys.readouterr().err


@pytest.mark.slow
def test_a_session_is_in_the_graph_while_it_runs(tmp_path):
    master, slave = find_free_ports(2)
    summary = tmp_path / "run.json"
    with router() as endpoint, peer(endpoint) as other:
        heard = Heard(other)
        settings = (
            "session=ros-run", "ros.start=true", f"ros.router={endpoint}", "ros.prefix=/lab",
            f"link.master=127.0.0.1:{master}", f"link.slave=127.0.0.1:{slave}",
        )  # fmt: skip
        words = [f"--set={setting}" for setting in settings]
        config = str(ROOT / "configs" / "demo.yaml")
        subprocess.run(
            [sys.executable, "-m", "teleop", "run", "--config", config, "--view", "none",
             "--duration", "4", "--json", str(summary), *words],
            check=True, env=OURS, timeout=2 * START_S,
        )  # fmt: skip
        sent = json.loads(summary.read_text())["ros"]["sent"]
        assert sent["slave/measured_js"] > 100
        assert len(heard.samples["/lab/slave/measured_js"]) > 0.9 * sent["slave/measured_js"]
        assert not any("/tendon_teleop" in token for token in heard.tokens)
