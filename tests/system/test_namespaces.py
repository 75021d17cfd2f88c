"""Master, router and slave on machines of their own, and a cable that is pulled between them."""

import json
import signal
import sys

import numpy as np
import pytest

from studies.testbed.processes import START_S, pause, wait_for_condition
from teleop.cli import commands
from teleop.messages.topics import COMMAND, HAND, STATE, TENDONS
from teleop.recording.reader import open_recording, read_columns
from teleop.runtime.clock import now_ns
from teleop.session.state_machine import State
from tests.system.namespaces import Network, require_namespaces

pytestmark = pytest.mark.slow

LIMIT_S = 0.050  # what a side has to be safe, counted from the last message that it could hear
HELD_S, PERIOD_S = 12.0, 14.0  # the hand holds the switch for so long, in each such period
SESSION = "room-1"


class Theatre:
    """A session whose sides meet at a router between them; the recorder runs at the router."""

    def __init__(self, folder, config):
        self.folder = folder
        self.network = Network(
            ("master", "router", "slave"), (("router", "master"), ("router", "slave"))
        )
        self._config = config
        self.running = {}

    def __enter__(self):
        self.network.__enter__()
        self.routers = {
            side: f"{self.network.address['router', side]}:7450" for side in ("master", "slave")
        }
        issue_keys(self.folder)
        return self

    def __exit__(self, *_):
        self.network.__exit__()

    def start_all(self):
        listen = [f"--listen={end}" for end in self.routers.values()]
        self._start(
            "router",
            "router",
            *listen,
            f"--session={SESSION}",
            f"--keys={self.folder / 'router-keys'}",
        )
        self.wait_for_text("router", "router at")
        watch = [sys.executable, "-m", "tests.system.watch_states", self.routers["slave"]]
        watch += [str(self.folder / "watch-keys"), SESSION]
        self.network.start("router", watch, self.folder / "watch.log")
        self._join("router", "record", self.routers["slave"], "--out", str(self.folder))
        self._join("slave", "slave", self.routers["slave"])
        self.wait_for_text("watch", "slave ready")
        switch = f"master.device.engage=[[0.5, {HELD_S}]]"
        period = f"master.device.engage_period={PERIOD_S}"
        self._join("master", "master", self.routers["master"], "--set", switch, "--set", period)
        self.wait_for_text("watch", "slave engaged")

    def _join(self, host, command, router, *more):
        keys = self.folder / f"{command}-keys"
        shared = [f'link.routers=["{router}"]', f"link.keys={keys}", f"session={SESSION}"]
        words = [f"--set={text}" for text in shared]
        summary = str(self.folder / f"{command}.json")
        self._start(host, command, "--config", str(self._config), *words, "--json", summary, *more)

    def _start(self, host, command, *words):
        whole = [sys.executable, "-m", "teleop", command, *words]
        self.running[command] = self.network.start(host, whole, self.folder / f"{command}.log")

    def text(self, command):
        return (self.folder / f"{command}.log").read_text()

    def wait_for_text(self, command, words):
        assert wait_for_condition(lambda: words in self.text(command), 2 * START_S), self.text(
            command
        )

    def cut(self, side, seconds):
        """Pull the cable of a side for some time; return when [ns]."""
        self.network.plug("router", side, up=False)
        begin = now_ns()
        pause(seconds)
        end = now_ns()
        self.network.plug("router", side, up=True)
        return begin, end

    def end(self):
        """End all; return the summaries."""
        for command in ("master", "slave", "record", "router"):
            self.running[command].send_signal(signal.SIGINT)
            self.running[command].wait(20.0)
        return {
            side: json.loads((self.folder / f"{side}.json").read_text())
            for side in ("master", "slave")
        }

    @property
    def recording(self):
        (path,) = self.folder.glob("*.mcap")
        return path


def issue_keys(folder):
    """Make an authority, and the keys of each process in a folder of its own."""
    authority = str(folder / "authority")
    assert commands.main(["keys", "init", authority]) == 0
    for command, role, session in (
        ("master", "master", SESSION),
        ("slave", "slave", SESSION),
        ("record", "recorder", SESSION),
        ("watch", "viewer", SESSION),
        ("router", "router", "all"),
    ):
        keys = ["--role", role, "--session", session, "--out", str(folder / f"{command}-keys")]
        assert commands.main(["keys", "issue", authority, *keys]) == 0


def spans(stamps, truth):
    """Return the first and last stamp [ns] of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], truth.astype(int), [0]))))
    return [(int(stamps[a]), int(stamps[b - 1])) for a, b in zip(edges[::2], edges[1::2])]  # noqa: B905


@pytest.fixture
def theatre(tmp_path, demo_config):
    require_namespaces()
    with Theatre(tmp_path, demo_config) as theatre:
        theatre.start_all()
        yield theatre


@pytest.mark.parametrize(("side", "seconds"), [("master", 1.0), ("slave", 1.0), ("slave", 5.0)])
def test_a_cable_that_is_pulled_and_plugged_in_again_never_moves_anything(theatre, side, seconds):
    pause(1.5)  # hand and tip are moving
    begin, end = theatre.cut(side, seconds)
    other = "slave" if side == "master" else "master"
    theatre.wait_for_text("watch", f"{other} holding")
    pause(max(0.0, PERIOD_S + 4.0 - 3.0 - seconds))  # until it was released and pressed again
    summaries = theatre.end()

    assert open_recording(theatre.recording).session == SESSION
    states = read_columns(theatre.recording, STATE.name)
    tendons = read_columns(theatre.recording, TENDONS.name)
    hand = read_columns(theatre.recording, HAND.name)
    limit = begin + round(LIMIT_S * 1e9)
    engaged = states["state"] == State.ENGAGED
    first, *others = spans(states["stamp_ns"], engaged)
    assert first[0] < begin
    if side == "master":  # the recorder heard the slave all the time
        assert first[1] < limit
        asked = tendons["commanded_displacement"][:, 0]
        during = (tendons["stamp_ns"] > limit) & (tendons["stamp_ns"] < end + 1_000_000_000)
        assert np.ptp(asked[(tendons["stamp_ns"] < begin) & np.isfinite(asked)]) > 1e-4
        assert during.sum() > 100  # enough to tell, on a busy machine too
        assert np.ptp(asked[during]) == 0.0
    else:
        away = (hand["stamp_ns"] > limit) & (hand["stamp_ns"] < end)
        assert away.sum() > 100
        assert np.abs(hand["force"][away]).max() == 0.0
        assert not (hand["state"][away] == State.ENGAGED).any()
    # after it was plugged in: the operator still held the switch, and nothing coupled again until
    # he had let go and pressed anew
    assert others, "it was not engaged again"
    commands = read_columns(theatre.recording, COMMAND.name)
    released = commands["stamp_ns"][
        (commands["stamp_ns"] > end) & (commands["state"] == State.READY)
    ]
    assert others[0][0] > released.min() > end
    before = (commands["stamp_ns"] > end) & (commands["stamp_ns"] < released.min())
    after_cut = {int(state) for state in np.unique(commands["state"][before])}
    assert after_cut <= {State.HOLDING, State.FAULT}
    for summary in summaries.values():
        assert summary["rejected"] == dict.fromkeys(summary["rejected"], 0)
