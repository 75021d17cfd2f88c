"""Sessions of one user on one machine: each has its own place, and commands find them."""

import argparse
import errno
import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from teleop.cli import commands
from teleop.config.loading import ConfigDocument
from teleop.errors import PeerError, UsageError
from teleop.session import own_endpoints, running_sessions
from teleop.session.config import RunConfig, read_config
from teleop.session.running_sessions import (
    RunningSession,
    create_session_name,
    describe_absence,
    find_session,
    list_sessions,
    register_session,
)
from tests.teleop.link.bench import wait_until

_HOLDER = """
import time
from teleop.session.running_sessions import RunningSession, register_session
with register_session(RunningSession(session="other", place={}, endpoints=())):
    print("listed", flush=True)
    time.sleep(60)
"""


@pytest.fixture(autouse=True)
def runtime(tmp_path, monkeypatch):
    """A folder of the user for the registry."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(running_sessions, "_RUN_USER", tmp_path / "none")
    monkeypatch.setattr(running_sessions, "_TEMPORARY", ())  # sessions outside of the test
    monkeypatch.delenv("TMPDIR", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "home"))
    return tmp_path / "tendon-teleop"


def entry(session="a", port=20001, config=""):
    link = {"master": f"127.0.0.1:{port}", "slave": f"127.0.0.1:{port + 1}"}
    return RunningSession(
        session=session,
        place={"session": session, "link": link},
        endpoints=tuple(link.values()),
        config=config,
    )


def words(*overrides, session=None, config=None):
    return argparse.Namespace(session=session, config=config, overrides=list(overrides))


def test_a_session_is_listed_while_it_runs(runtime):
    with register_session(entry("a")), register_session(entry("b")):
        assert {e.session for e in list_sessions()} == {"a", "b"}
        assert runtime.stat().st_mode & 0o077 == 0
    assert list_sessions() == []
    assert list(runtime.iterdir()) == []


def test_a_session_that_does_not_answer_is_told_from_none_at_all():
    alone = describe_absence("demo", "no master answers", ["127.0.0.1:7451"])
    assert alone.startswith("no session of yours runs on this machine, and no master answers at")
    with register_session(entry("a")), register_session(entry("b")):
        assert describe_absence("c", "no master answers", ["127.0.0.1:7451"]) == (
            "session 'c': no master answers; running on this machine: a, b"
        )


def test_a_loopback_interface_that_is_down_is_named_at_once(monkeypatch, capsys):
    def refuse(*_):
        raise OSError(errno.ENETUNREACH, "Network is unreachable")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    assert commands.main(["run", "--view", "none", "--duration", "2"]) == 1
    said = "teleop: 127.0.0.1 cannot be connected to: Network is unreachable; bring the loopback"
    assert capsys.readouterr().err.startswith(said)


def test_a_session_whose_process_was_killed_is_forgotten(runtime):
    with subprocess.Popen([sys.executable, "-c", _HOLDER], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"listed\n"
        assert [e.session for e in list_sessions()] == ["other"]
        process.send_signal(signal.SIGKILL)
    wait_until(lambda: list_sessions() == [])
    assert list(runtime.iterdir()) == []


def test_a_folder_where_others_may_write_is_not_believed(runtime, tmp_path):
    runtime.mkdir()
    (runtime / "x.1.json").write_text("{}")
    runtime.chmod(0o777)
    with register_session(entry()):
        assert [e.session for e in list_sessions()] == ["a"]
        assert os.listdir(runtime) == ["x.1.json"]
        (path,) = (tmp_path / "home").glob("**/*.json")
        assert path.parent.stat().st_mode & 0o077 == 0


def test_without_a_runtime_folder_the_registry_is_one_of_the_user_below_tmp(monkeypatch, tmp_path):
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with register_session(entry()):
        assert [e.session for e in list_sessions()] == ["a"]
        assert (tmp_path / f"tendon-teleop-{os.getuid()}").is_dir()


def test_a_command_joins_the_only_session_and_asks_which_of_several():
    assert read_config(words()).load(RunConfig).session == "demo"
    with register_session(entry("a", 20001)):
        assert read_config(words()).load(RunConfig).link.slave == "127.0.0.1:20002"
        with register_session(entry("b", 20005)):
            with pytest.raises(UsageError, match=r"2 sessions are running: .*name one with"):
                read_config(words()).load(RunConfig)
            joined = read_config(words(session="b")).load(RunConfig)
            assert (joined.session, joined.link.master) == ("b", "127.0.0.1:20005")
            assert read_config(words("session=b")).load(RunConfig).link.master == "127.0.0.1:20005"
            elsewhere = read_config(words("link.slave=127.0.0.1:9")).load(RunConfig)
            assert (elsewhere.session, elsewhere.link.slave) == ("demo", "127.0.0.1:9")
            assert read_config(words(), join=False).load(RunConfig).session == "demo"


def test_a_config_file_finds_the_session_that_was_started_with_it(tmp_path):
    mine, other = tmp_path / "mine.yaml", tmp_path / "other.yaml"
    for path in (mine, other):
        path.write_text("rate_hz: 500\n")
    with (
        register_session(entry("m", 20001, str(mine))),
        register_session(entry("o", 20005, str(other))),
    ):
        assert read_config(words(config=mine)).load(RunConfig).session == "m"
        assert read_config(words(config=other)).load(RunConfig).session == "o"
        assert find_session("m").config == str(mine)


def test_a_session_that_does_not_run_here_is_named_with_those_that_do():
    with (
        register_session(entry("a")),
        pytest.raises(UsageError, match=r"--session x: .*running: a\."),
    ):
        read_config(words(session="x")).load(RunConfig)


def test_a_session_takes_a_name_and_endpoints_of_its_own(tmp_path):
    path = tmp_path / "Two Arms.yaml"
    path.write_text("rate_hz: 500\n")
    runs = [
        own_endpoints.choose_place(ConfigDocument.read(path), None).load(RunConfig)
        for _ in range(5)
    ]
    ends = [end for run in runs for end in (run.link.master, run.link.slave)]
    assert len(set(ends)) == len(ends)
    assert len({run.session for run in runs}) == len(runs)
    assert all(run.session.startswith("two-arms-") for run in runs)
    assert create_session_name("demo") != create_session_name("demo")


def test_what_config_or_options_state_is_kept(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("session: bench\nimpair: {seed: 1}\n")
    document = ConfigDocument.read(path)
    chosen = own_endpoints.choose_place(document, None)
    assert {".".join(override.keys) for override in chosen.overrides} == {
        "link.master", "link.slave", "impair.endpoint",
    }  # fmt: skip
    assert chosen.load(RunConfig).session == "bench"
    stated = ConfigDocument.read(None, ["link.master=127.0.0.1:9"])
    assert own_endpoints.choose_place(stated, None) == stated
    assert own_endpoints.choose_place(document, "mine").load(RunConfig).session == "mine"


def test_a_name_is_given_once(tmp_path):
    with (
        register_session(entry("bench")),
        pytest.raises(PeerError, match="'bench' is running already"),
    ):
        own_endpoints.choose_place(ConfigDocument.read(None, ["session=bench"]), None)


def test_the_entry_leads_to_the_session_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "keys").mkdir()
    document = ConfigDocument.read(None, ["link.keys=keys"])
    run = own_endpoints.choose_place(document, None).load(RunConfig)
    with register_session(own_endpoints.build_entry(run, None, None)):
        monkeypatch.chdir("/")
        joined = read_config(words()).load(RunConfig)
    assert joined.link.keys == tmp_path / "keys"
    assert (joined.session, joined.link.slave) == (run.session, run.link.slave)


def test_the_command_lists_them(capsys, tmp_path):
    assert commands.main(["sessions"]) == 0
    assert capsys.readouterr().out == "no sessions running\n"
    with register_session(entry("a", config="/x/demo.yaml")):
        assert commands.main(["sessions", "--json", str(tmp_path / "s.json")]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"a  process {os.getpid()}  since ")
    assert "127.0.0.1:20001" in out
    assert json.loads(Path(tmp_path / "s.json").read_text())["sessions"][0]["session"] == "a"
