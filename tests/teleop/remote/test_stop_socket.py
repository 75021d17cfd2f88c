"""Emergency stops that do not pass the network."""

import errno
import os
import secrets
import socket
import stat
import subprocess
import sys
import tempfile
import threading
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest

from teleop.cli import commands
from teleop.errors import TeleopError
from teleop.remote import stop_over_link, stop_socket
from teleop.remote.stop_socket import StopSocket, list_sessions_with_sockets, request_local
from teleop.session import running_sessions


@pytest.fixture(autouse=True)
def runtime_folder(monkeypatch):
    with tempfile.TemporaryDirectory(dir="/tmp") as name:  # short, as the address of a socket
        monkeypatch.setenv("XDG_RUNTIME_DIR", name)
        # nor those of sessions that run beside the tests
        monkeypatch.setattr(running_sessions, "_RUN_USER", Path(name))
        monkeypatch.setattr(running_sessions, "_TEMPORARY", ())
        monkeypatch.setattr(stop_socket, "ANSWER_S", 0.5)
        yield Path(name)


def datagrams():
    return socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)


class Side:
    """A loop that obeys requests: `tick` answers with its state, and with that of its peer."""

    def __init__(self, own, role, peer=()):
        self.own, self.role, self.peer = own, role, list(peer)
        self.state, self.stops, self.reasons = "engaged", 4, []

    def tick(self):
        for request in self.own.take():
            if not request.is_reset:
                self.reasons.append(request.reason)
                self.stops += self.state != "stopped"
                self.state = "stopped"
            elif request.number == self.stops:
                self.state = "ready"
        if self.own.is_asked:
            self.own.answer([f"{self.role} {self.state} {self.stops}", *self.peer])


@contextmanager
def running(*sides):
    """Tick sides in a thread, as a loop does."""
    end = threading.Event()

    def work():
        while not end.wait(0.002):
            for side in sides:
                side.tick()

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()


@contextmanager
def ticking(role="master", *peer, state="engaged", session="s"):
    """One side, and what it says of its peer; ticks."""
    with StopSocket(session, role) as own:
        assert not own.warning
        side = Side(own, role, peer)
        side.state = state
        with running(side):
            yield side


def stop(session="s", reason=""):
    """Call for a stop; return the state of each side that is known of."""
    return request_local(session, is_reset=False, reason=reason).states


def test_both_sides_stop_and_are_reset_by_the_number_of_their_stop():
    with ticking() as master, ticking("slave") as slave:
        answers = request_local("s", is_reset=False, reason="smoke")
        assert answers.states == {"master": "stopped", "slave": "stopped"}
        assert set(master.reasons) == {"smoke"}
        assert answers.are_direct
        assert (master.stops, slave.stops) == (5, 5)
        answers = request_local("s", is_reset=True, reason="")
        assert answers.states == {"master": "ready", "slave": "ready"}


def test_a_side_tells_of_its_peer_on_another_machine():
    with ticking("slave", "master engaged"):
        answers = request_local("s", is_reset=False, reason="")
    assert answers.states == {"master": "engaged", "slave": "stopped"}
    assert not answers.are_direct


def test_a_side_that_does_not_answer_is_silent_even_if_its_peer_speaks_for_it():
    with ticking("master", "slave stopped"), StopSocket("s", "slave"):
        assert stop() == {"master": "stopped", "slave": "silent"}


@pytest.mark.parametrize("is_reset", [False, True])
def test_a_side_elsewhere_that_is_silent_is_not_waited_for(monkeypatch, is_reset):
    monkeypatch.setattr(stop_socket, "ANSWER_S", 60.0)
    with ticking("master", "slave silent", state="stopped" if is_reset else "engaged"):
        answers = request_local("s", is_reset, reason="")
    assert answers.states == {"master": "ready" if is_reset else "stopped", "slave": "silent"}
    assert answers.has_silent_peer


def test_of_two_words_on_a_side_elsewhere_the_silence_counts():
    for lines in (b"slave silent\nslave stopped", b"slave stopped\nslave silent"):
        answers = stop_socket.LocalAnswers({"watch"})
        answers.add(lines)
        assert answers.states == {"slave": "silent"}


def refuse_to_bind(monkeypatch):
    """As in a folder that is read-only, or on a file system without free inodes."""

    def fail(path, _stack):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(stop_socket, "_bind_socket", fail)


@pytest.mark.parametrize(
    ("found", "code"), [({"master": "stopped"}, 0), ({}, 1), ({"master": "engaged"}, 1)]
)
def test_a_stop_is_sent_though_no_answer_can_be_received_but_over_the_network(
    monkeypatch, found, code
):
    monkeypatch.setattr(stop_over_link, "request_over_link", lambda *_: found)
    with StopSocket("s", "master") as own:
        refuse_to_bind(monkeypatch)
        side = Side(own, "master")
        with running(side):
            assert commands.main(["stop", "--why", "smoke", "--set", "session=s"]) == code
        side.tick()
    assert side.state == "stopped"
    assert set(side.reasons) == {"smoke"}


def test_another_session_is_not_stopped():
    with ticking(session="s-2") as side:
        for name in ("s", "", "*", "../s-2", "s-2.*"):
            assert stop(name) == {}
    assert side.state == "engaged"


@pytest.mark.parametrize(
    "reason", ["", "\udcff\udc80", "line\nstop\nreset 4", "x" * 100_000, "é\0"]
)
def test_a_stop_does_not_depend_on_its_reason(reason):
    with ticking():
        assert stop(reason=reason) == {"master": "stopped"}


@pytest.mark.parametrize(
    "data", [b"", b"stopp", b"reset", b"\xff" * 4000, b"reset -1", b"reset 99999999999"]
)
def test_what_is_no_request_changes_nothing(data, runtime_folder):
    with StopSocket("s", "master") as own, datagrams() as sender:
        side = Side(own, "master")
        (path,) = (runtime_folder / "tendon-teleop").iterdir()
        sender.sendto(data, str(path))
        side.tick()
    assert side.state == "engaged"


def test_many_requests_take_a_bounded_part_of_a_tick(runtime_folder):
    with StopSocket("s", "master") as own, datagrams() as sender:
        sender.setblocking(False)
        (path,) = (runtime_folder / "tendon-teleop").iterdir()
        with suppress(BlockingIOError):
            for _ in range(100_000):
                sender.sendto(b"stop", str(path))
        assert len(own.take()) == stop_socket.REQUESTS


def test_only_the_user_reaches_a_socket_and_it_is_gone_at_the_end(runtime_folder):
    folder = runtime_folder / "tendon-teleop"
    with StopSocket("s", "slave"):
        (path,) = folder.iterdir()
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert list_sessions_with_sockets() == {"s"}
    assert list(folder.iterdir()) == []


def test_the_socket_of_a_killed_process_is_removed(runtime_folder):
    code = (
        "import os; from teleop.remote.stop_socket import StopSocket; "
        "StopSocket('s', 'slave').__enter__(); os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code], check=False)
    (left,) = runtime_folder.glob("*/*.stop")
    assert list_sessions_with_sockets() == set()  # `teleop stop` does not ask which session
    assert not left.exists()


def test_what_a_killed_process_of_the_same_number_left_is_not_in_the_way(runtime_folder):
    """In a container that is restarted the numbers begin anew, and its files may stay."""
    with StopSocket("s", "slave"):
        (path,) = runtime_folder.glob("*/*.stop")
        name = path.name
    with datagrams() as killed:
        killed.bind(str(path))
    with ticking("slave"):
        assert stop() == {"slave": "stopped"}
        (path,) = runtime_folder.glob("*/*.stop")  # that of the killed process is removed
        assert path.name != name


def test_a_process_that_is_killed_during_a_request_is_not_waited_for(monkeypatch, runtime_folder):
    with datagrams() as killed:
        killed.bind(str(runtime_folder / "s.slave.stop"))
    paths = [(runtime_folder / "s.slave.stop", "s", "slave")]
    monkeypatch.setattr(stop_socket, "_list_sockets", lambda: paths)
    assert stop() == {"slave": "silent"}
    assert not paths[0][0].exists()


def test_a_side_that_ends_in_order_during_a_stop_is_no_failure(monkeypatch, capsys):
    """Its socket is still there, but its loop has ended; so does the process soon after."""
    monkeypatch.setattr(stop_socket, "ANSWER_S", 60.0)
    monkeypatch.setattr(stop_over_link, "request_over_link", lambda *_: pytest.fail("asked"))
    with ticking("slave", "master off"), ExitStack() as ending:
        ending.enter_context(StopSocket("s", "master"))
        threading.Timer(0.3, ending.close).start()
        assert commands.main(["stop", "--session", "s"]) == 0
    assert capsys.readouterr().out.splitlines() == ["master    ended", "slave     stopped"]


def test_a_stop_of_a_session_that_ends_meanwhile_says_so(monkeypatch, capsys):
    monkeypatch.setattr(stop_socket, "ANSWER_S", 60.0)
    with ExitStack() as ending:
        for role in ("master", "slave"):
            ending.enter_context(StopSocket("s", role))
        threading.Timer(0.3, ending.close).start()
        assert commands.main(["stop", "--session", "s"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "the session has ended"


def test_a_folder_that_others_may_enter_is_not_used(runtime_folder):
    folder = runtime_folder / "tendon-teleop"
    folder.mkdir()
    folder.chmod(0o750)
    with ticking("slave"):
        assert list(folder.iterdir()) == []
        assert stop() == {"slave": "stopped"}


@pytest.fixture
def occupied(monkeypatch, runtime_folder):
    """Folders that another user, or a link of his, has made first, as anybody can below /tmp."""
    monkeypatch.setenv("TMPDIR", str(runtime_folder / "a"))
    monkeypatch.setattr(running_sessions, "_RUN_USER", runtime_folder / "b")
    monkeypatch.setattr(running_sessions, "_TEMPORARY", (str(runtime_folder / "c"),))
    monkeypatch.setenv("XDG_STATE_HOME", str(runtime_folder / "home"))
    (runtime_folder / "elsewhere").mkdir(mode=0o700)
    (runtime_folder / "tendon-teleop").symlink_to(runtime_folder / "elsewhere")
    (runtime_folder / "b" / str(os.getuid())).mkdir(parents=True)
    (runtime_folder / "b" / str(os.getuid()) / "tendon-teleop").write_text("")
    for name in ("a", "c"):
        (runtime_folder / name / f"tendon-teleop-{os.getuid()}").mkdir(parents=True)
        (runtime_folder / name / f"tendon-teleop-{os.getuid()}").chmod(0o777)
    return runtime_folder


def test_nobody_takes_away_the_local_stop_by_making_its_folders_first(occupied):
    with ticking():
        (path,) = occupied.glob("**/*.stop")
        assert path.is_relative_to(occupied / "home" / "teleop")
        assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
        assert stop() == {"master": "stopped"}


def test_a_folder_in_which_no_socket_can_be_made_is_passed_over(monkeypatch, runtime_folder):
    """Without free inodes, for instance."""
    bind, full = stop_socket._bind_socket, runtime_folder / "tendon-teleop"

    def fail(path, stack):
        if path.parent == full:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        return bind(path, stack)

    monkeypatch.setattr(stop_socket, "_bind_socket", fail)
    with ticking():
        assert stop() == {"master": "stopped"}


def test_without_any_folder_the_stop_goes_over_the_network(monkeypatch, occupied):
    monkeypatch.setenv("XDG_STATE_HOME", "relative")
    with StopSocket("s", "slave") as own:
        assert "over the network only" in own.warning
        assert own.take() == []
        assert own.fileno() == -1


def test_a_process_with_another_environment_finds_the_others(monkeypatch, runtime_folder):
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setenv("TMPDIR", str(runtime_folder))
    with ticking():
        (runtime_folder / "mine").mkdir()
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime_folder / "mine"))
        assert stop() == {"master": "stopped"}


def test_a_folder_too_long_for_the_address_of_a_socket_is_passed_over(monkeypatch, runtime_folder):
    long = runtime_folder / ("x" * 90)
    long.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(long))
    name = f"s{secrets.token_hex(4)}"
    with ticking(session=name):
        assert stop(name) == {"master": "stopped"}


NETWORK = {
    "stopped": ({"slave": "stopped"}, 0, "slave     stopped"),
    "moving": ({"slave": "engaged"}, 1, "the slave has NOT stopped"),
    "absent": ({}, 1, "no answer from the slave, which may NOT have stopped"),
    "fails": (TeleopError("no keys"), 1, "no answer from the slave, which may NOT have stopped"),
}


@pytest.mark.parametrize(("found", "code", "said"), NETWORK.values(), ids=NETWORK)
def test_a_side_that_is_silent_to_its_peer_is_sought_over_the_network(
    monkeypatch, capsys, found, code, said
):
    asked = []

    def request(config, *_):
        asked.append(config.session)
        if isinstance(found, Exception):
            raise found
        return found

    monkeypatch.setattr(stop_over_link, "request_over_link", request)
    with ticking("master", "slave silent"):
        assert commands.main(["stop", "--set", "session=s"]) == code
    out, err = capsys.readouterr()
    assert asked == ["s"]
    assert "master    stopped" in out
    assert said in out + err
    assert ("no keys" in out) == (found is NETWORK["fails"][0])


@pytest.mark.parametrize(("found", "code"), [({}, 1), ({"slave": "ready"}, 0)])
def test_a_reset_does_not_pass_over_a_silent_side(monkeypatch, capsys, found, code):
    monkeypatch.setattr(stop_over_link, "request_over_link", lambda *_: found)
    with ticking("master", "slave silent", state="stopped"):
        assert commands.main(["stop", "--reset", "--set", "session=s"]) == code
    assert ("no answer from the slave, which may be stopped" in capsys.readouterr().err) == code


def test_another_session_is_not_asked_for_a_silent_side(monkeypatch, capsys):
    """Its socket gives the name of the session, but not its endpoints."""
    monkeypatch.setattr(stop_over_link, "request_over_link", lambda *_: pytest.fail("asked"))
    with ticking("master", "slave silent"):
        assert commands.main(["stop"]) == 1
    assert "teleop stop --config FILE" in capsys.readouterr().out


def test_nothing_slow_is_imported():
    code = (
        "import sys; from teleop.cli import commands; commands.main(['stop', '--session', 's']); "
        "slow = {'numpy', 'zenoh', 'numba', 'yaml', 'importlib.metadata', 'logging', "
        "'dataclasses', 'inspect', 'tempfile', 'ctypes', 'datetime', 'difflib'}; "
        "print(sorted(slow & sys.modules.keys()))"
    )
    words = [sys.executable, "-c", code]
    with ticking(), ticking("slave"):
        done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["master    stopped", "slave     stopped", "[]"]
