"""`teleop router`: where it listens, what it demands, and the configs of docs/how-to/network.md."""

import argparse
import json
import re
import shlex
import signal
import subprocess
import sys
import time

import pytest
import zenoh

from master.config import MasterConfig
from slave.config import SlaveConfig
from studies.testbed.processes import OURS, find_free_ports
from teleop.cli import commands
from teleop.config.loading import load
from teleop.errors import UsageError
from teleop.link import Link, LinkConfig
from teleop.link.router import (
    DEFAULT_ENDPOINT,
    RouterConfig,
    build_router_config,
    build_router_link,
)
from teleop.messages.topics import COMMAND, Role
from teleop.session.config import RunConfig
from tests.root import ROOT
from tests.teleop.link.bench import wait_until

TOPOLOGIES = sorted((ROOT / "configs" / "topologies").glob("*.yaml"))
PAGE = (ROOT / "docs" / "how-to" / "network.md").read_text()


def words(**options):
    lists = {name: options.get(name, []) for name in ("session", "listen", "connect")}
    return argparse.Namespace(**lists)


def asked(*overrides, routers=(), **options):
    """The router's config by overrides, the session's routers, and options."""
    return build_router_config(
        words(**options),
        RunConfig(link=LinkConfig(routers=routers)),
        load(None, RouterConfig, "router", overrides),
    )


def test_options_config_and_defaults_say_what_it_serves_and_where():
    assert asked() == RouterConfig(("demo",), (DEFAULT_ENDPOINT,))
    assert asked(routers=("127.0.0.1:1",)).listen == ("127.0.0.1:1",)
    stated = ('router.listen=["127.0.0.1:2"]', 'router.connect=["127.0.0.1:3"]')
    sessions = 'router.sessions=["a", "b"]'
    config = asked(*stated, sessions, routers=("127.0.0.1:1",))
    assert config == RouterConfig(("a", "b"), ("127.0.0.1:2",), ("127.0.0.1:3",))
    options = asked(*stated, sessions, listen=["127.0.0.1:4"], session=["c"])
    assert options == RouterConfig(("c",), ("127.0.0.1:4",), ("127.0.0.1:3",))


def test_off_loopback_it_must_have_keys(tmp_path):
    far = RouterConfig(listen=("10.0.0.5:7450",))
    with pytest.raises(UsageError, match=r"router: off loopback, link\.keys"):
        build_router_link(LinkConfig(), far, None)
    assert build_router_link(LinkConfig(), far, tmp_path).keys == tmp_path
    assert build_router_link(LinkConfig(insecure=True), far, None).insecure
    assert (
        build_router_link(LinkConfig(), RouterConfig(listen=(DEFAULT_ENDPOINT,)), None).keys is None
    )


@pytest.mark.parametrize("bad", ["tcp/127.0.0.1:1", "127.0.0.1", "0.0.0.0:7450"])
def test_a_wrong_endpoint_is_one_line(bad):
    with pytest.raises(UsageError, match=r"router\.listen\.0: "):
        asked(f'router.listen=["{bad}"]')
    with pytest.raises(UsageError, match=r"--connect\[0\]: "):
        asked(connect=[bad])


def test_the_command_says_where_it_is_and_who_comes(tmp_path):
    (port,) = find_free_ports(1)
    command = [sys.executable, "-m", "teleop", "router", "--session", "room-1"]
    command += ["--listen", f"127.0.0.1:{port}"]
    with subprocess.Popen(
        [*command, "--json", str(tmp_path / "r.json")], stdout=subprocess.PIPE, text=True, env=OURS
    ) as process:
        assert f'link.routers: ["127.0.0.1:{port}"]' in process.stdout.readline()
        with Link(LinkConfig(routers=(f"127.0.0.1:{port}",)), "room-1", Role.SLAVE):
            assert process.stdout.readline() == "session room-1: slave joined\n"
        assert process.stdout.readline() == "session room-1: slave left\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(10.0) == 0
    assert json.loads((tmp_path / "r.json").read_text())["sessions"] == ["room-1"]


@pytest.mark.parametrize("path", TOPOLOGIES, ids=lambda path: path.stem)
def test_the_config_of_a_topology_is_whole_and_on_the_page(path):
    shared = load(path, RunConfig, None)
    load(path, SlaveConfig, "slave").check_rate(shared.rate_hz)
    load(path, MasterConfig, "master").check_rate(shared.rate_hz)
    router = load(path, RouterConfig, "router")
    assert set(shared.link.routers[:1]) >= set(router.listen[:1])
    assert path.name in PAGE
    assert (shared.link.keys is None) == (path.stem == "one-machine")


def test_the_two_sites_of_the_wide_area_meet():
    console, robot = (
        load(ROOT / f"configs/topologies/wide-area-{side}.yaml", RouterConfig, "router")
        for side in ("console", "robot")
    )
    assert set(robot.connect) <= set(console.listen)
    assert not console.connect


def test_commands_of_the_page_are_understood():
    """Each is parsed with its options, and not run."""
    found = re.findall(r"^ *(?:[\w-]+)?\$ +(teleop [^>\n]*)", PAGE, re.MULTILINE)
    assert len(found) > 20
    for line in found:
        command = shlex.split(line, comments=True)[1:]
        commands.build_parser(command[0]).parse_args(command)


def test_zenohd_takes_the_same_settings_as_a_file(tmp_path, capsys):
    authority, keys = str(tmp_path / "authority"), tmp_path / "keys"
    assert commands.main(["keys", "init", authority]) == 0
    for role, session in (("slave", "a"), ("viewer", "a"), ("router", "all")):
        issue = ["keys", "issue", authority, "--role", role, "--session", session]
        assert commands.main([*issue, "--out", str(keys)]) == 0
    (port,) = find_free_ports(1)
    capsys.readouterr()
    command = ["router", "--zenohd", "--session", "a", "--listen", f"127.0.0.1:{port}"]
    assert commands.main([*command, "--keys", str(keys)]) == 0
    text = capsys.readouterr().out
    assert "PRIVATE KEY" not in text
    config = LinkConfig(routers=(f"127.0.0.1:{port}",), keys=keys)
    with (
        zenoh.open(zenoh.Config.from_json5(text)),
        Link(config, "a", Role.SLAVE) as slave,
        Link(config, "a", Role.VIEWER) as viewer,
    ):
        slave.subscribe_latest(COMMAND)
        wait_until(lambda: viewer.is_present(Role.SLAVE))
        time.sleep(0.3)
        viewer._zenoh.put("teleop/a/command", b"x")
        time.sleep(0.3)
        counts = slave.take_latest(COMMAND).counts
        assert counts.rejected + counts.unknown == 0  # it ended at the router
    assert commands.main(command) == 2
