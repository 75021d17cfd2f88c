"""A whole session through the proxy: `teleop run` with an `impair` section."""

import json

import pytest

from tests.system.processes import free_ports
from tests.system.test_run import run


def test_a_run_goes_through_its_proxy_and_tells_what_that_did(demo_config, tmp_path):
    (port,) = free_ports(1)
    words = [
        f"impair.endpoint=127.0.0.1:{port}",
        "impair.to_slave.delay=0.02",
        "impair.to_master.loss=0.1",
    ]
    options = [word for text in words for word in ("--set", text)]
    code, out, err = run(demo_config, tmp_path, "--duration", "3", "--view", "none", *options)
    assert code == 0, out + err
    summary = json.loads((tmp_path / "run.json").read_text())
    assert 20.0 <= summary["master"]["latency_ms"]["p50"] < 25.0
    state = summary["impair"]["to_master"]["state"]
    assert state["lost"] == pytest.approx(0.1 * state["came"], rel=0.2)
    assert state["sent"] == state["came"] - state["lost"]
    assert f"{state['lost']} lost" in out


def test_a_mistake_in_the_section_is_one_line(demo_config, tmp_path):
    code, _, err = run(demo_config, tmp_path, "--set", "impair.to_slave.los=0.1")
    assert code == 2
    assert len(err.splitlines()) == 1
    assert "impair.to_slave.los: unknown key; did you mean 'loss'?" in err
