"""`teleop.Session`: a session as an object, in the user's own program."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from studies.testbed.processes import wait_for_condition
from teleop import (
    ButtonObserver,
    ConstantStimuli,
    Design,
    Session,
    TeleopError,
    UsageError,
    join_session,
    load_config,
)
from teleop.session.state_machine import State
from tests.root import ROOT

DEMO = ROOT / "configs" / "demo.yaml"
SLOW = {"rate_hz": 250.0, "slave.command_timeout": 0.2, "master.state_timeout": 0.2,
        "master.delay_max": 0.4, "realtime.priority": 0}  # fmt: skip


def list_children(pid):
    """Return the processes that the threads of a process have started."""
    pids = set()
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(FileNotFoundError):  # a thread that has ended meanwhile
            pids.update(map(int, (task / "children").read_text().split()))
    return pids


OWN = """
import dataclasses
import os
import signal
import sys
import threading
import time
from dataclasses import dataclass

from master.device import HandState
from master.devices.extension import DeviceExtension
from teleop import Session, TeleopError, load_config


class StillHand:
    axes = 1

    def __init__(self, place):
        self.place = place

    def read(self, time_s):
        # let go every 5 s: a busy machine may have a side ready only later
        return HandState((self.place,), (0.0,), time_s % 5.0 > 0.5)

    def write(self, force):
        pass

    def close(self):
        pass


@dataclass(frozen=True)
class StillHandConfig(DeviceExtension):
    place: float = 0.0

    def open(self):
        return StillHand(self.place)


def configure():
    config = load_config({demo!r}, {slow!r})
    return dataclasses.replace(
        config, master=dataclasses.replace(config.master, device=StillHandConfig(place=0.012))
    )
"""
MAIN = """

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # shells ignore it in the background
    with Session(configure(), say=lambda line: None) as session:
"""


def start_program(folder, body):
    """Start a script of a user that has a session with a device of its own."""
    script = folder / "own_program.py"
    script.write_text(OWN.format(demo=str(DEMO), slow=SLOW) + MAIN + body)
    return subprocess.Popen(
        [sys.executable, script],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def runs(pid):
    """Return whether a process runs; one that nobody has waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


ENGAGED = '        session.wait_for("engaged")\n'


@pytest.mark.parametrize("seconds", [pytest.param(0.0, marks=pytest.mark.slow), 0.13])
def test_ctrl_c_ends_everything(tmp_path, seconds):
    body = ENGAGED + '        print("engaged", flush=True)\n        time.sleep(60.0)\n'
    program = start_program(tmp_path, body)
    assert program.stdout.readline() == "engaged\n"
    pids = list_children(program.pid)
    assert len(pids) == 2
    program.send_signal(signal.SIGINT)
    time.sleep(seconds)
    program.send_signal(signal.SIGINT)  # impatience changes nothing
    _, err = program.communicate(timeout=60)
    # a second one as Python ends is raised in whatever that does, and ignored
    assert err.splitlines()[-1].removesuffix(": ") == "KeyboardInterrupt"
    assert program.returncode == -signal.SIGINT
    assert not any(map(runs, pids))


def test_a_session_that_nothing_ends_ends_with_the_program(tmp_path):
    """As of a notebook that was closed: its callbacks' thread must not keep Python waiting."""
    body = ENGAGED + "        session.end = lambda: None\n"
    body += '        print("engaged", flush=True)\n        time.sleep(0.5)\n'
    program = start_program(tmp_path, body)
    assert program.stdout.readline() == "engaged\n"
    pids = list_children(program.pid)
    assert len(pids) == 2
    program.communicate(timeout=60)
    assert program.returncode == 0
    assert not any(map(runs, pids))


def test_a_device_of_ones_own_needs_no_entry_point_and_a_killed_child_is_one_line(tmp_path):
    body = ENGAGED + (
        '        print(next(session.blocks(1.0, "hand"))["position"][-1, 0], flush=True)\n'
        "        try:\n"
        "            for _ in session.states():\n"
        "                pass\n"
        "        except TeleopError as error:\n"
        "            print(error, flush=True)\n"
        "        raise ValueError(7)\n"
    )
    program = start_program(tmp_path, body)
    assert program.stdout.readline() == "0.012\n"
    pids = list_children(program.pid)
    os.kill(max(pids), signal.SIGKILL)
    out, err = program.communicate(timeout=60)
    assert "ended by SIGKILL" in out
    assert len(out.splitlines()) == 1
    assert err.splitlines()[-1] == "ValueError: 7"  # the program's own comes first
    assert not any(map(runs, pids))


def test_what_is_wrong_is_one_line_before_anything_starts(tmp_path):
    before = list_children(os.getpid())
    with pytest.raises(UsageError, match=r"--set rate_hz=5: rate_hz: 5.0: must be 100 to 4000 Hz"):
        Session(DEMO, {"rate_hz": 5})
    with pytest.raises(UsageError, match=r"no_such.yaml"):
        Session(tmp_path / "no_such.yaml")
    with pytest.raises(UsageError, match=r"master\.device 'virtual'"):
        _ = Session(DEMO).operator
    with pytest.raises(UsageError, match="not open"):
        next(Session(DEMO).states())
    assert list_children(os.getpid()) == before


def test_a_process_that_does_not_start_ends_the_others(tmp_path):
    before = list_children(os.getpid())
    config = load_config(DEMO, {"slave.calibration": "no_such.yaml"})
    session = Session(config, SLOW, say=lambda _: None)
    with pytest.raises(UsageError, match=r"no_such.yaml"), session:
        pass
    assert list_children(os.getpid()) == before


def test_a_config_as_an_object_is_the_same_config(tmp_path):
    """Of every example, through the text that the processes get."""
    for path in sorted((ROOT / "configs").glob("*.yaml")):
        if "slave:" not in path.read_text():
            continue  # of another command
        config = load_config(path)
        other = dataclasses.replace(config, rate_hz=500.0)
        session = Session(other, name="same")
        assert dataclasses.replace(session.config, session=config.session, link=config.link,
                                   impair=config.impair) == other  # fmt: skip
        json.dumps(session._plan.document.tree, default=str)


# from here on with one session, which would take the processors from those above


@pytest.fixture(scope="module")
def lines():
    return []


@pytest.fixture(scope="module")
def session(tmp_path_factory, lines):
    patient = SLOW | {"master.device": {"type": "program", "timeout": 2.0}}
    session = Session(DEMO, patient, record=tmp_path_factory.mktemp("record"), say=lines.append)
    before = list_children(os.getpid())
    session.start()
    session.wait_for("ready")
    yield session
    session.end()  # a busy machine may drop messages on their way to the recorder
    assert list_children(os.getpid()) == before
    assert session.summary.slave.rate_hz > 50.0
    assert sum(session.summary.children["record"]["messages"].values()) > 100


@pytest.fixture
def engaged(session):
    session.operator.engage()
    session.wait_for("engaged")
    yield session
    session.operator.release()
    session.wait_for("ready")


def test_the_hand_moves_the_tip_and_feels_it(engaged):
    start = next(engaged.states()).position[0]
    for step in range(60):
        engaged.operator.move(0.05 * step / 59)
        time.sleep(0.02)
    goal = start + 0.05 * engaged.config.master.operator.position_scale
    for reached in engaged.states(10.0):  # on a busy machine the tip is late
        engaged.operator.move(0.05)
        if abs(reached.position[0] - goal) < 0.003 and reached.force[0] > 1.0:
            break
    assert reached.position[0] == pytest.approx(goal, abs=0.003)
    assert reached.force[0] > 1.0
    assert reached.force_low[0] <= reached.force[0] <= reached.force_high[0]
    assert wait_for_condition(lambda: engaged.operator.force[0] < -0.05, 1.0)


def test_states_and_blocks_have_every_message_once(engaged):
    states = list(engaged.states(0.5))
    assert states[0].time == 0.0
    assert np.all(np.diff([state.stamp_ns for state in states]) > 0)
    assert all(state.state is State.ENGAGED and state.position.shape == (1,) for state in states)
    sequences = np.concatenate([block["sequence"] for block in engaged.blocks(0.5, "hand", 0.05)])
    np.testing.assert_array_equal(np.diff(sequences), 1)
    assert len(sequences) > 50


def test_a_silent_program_lets_go_and_is_told_so(engaged):
    engaged.wait_for("ready", timeout=20.0)  # beyond the device's timeout
    with pytest.raises(TeleopError, match=r"nothing was sent for more than 2 s.*engage\(\) again"):
        engaged.operator.move(0.0)
    engaged.operator.engage()
    engaged.wait_for("engaged")


@pytest.mark.parametrize(
    ("position", "words"),
    [(np.nan, "finite"), (2.0, "within"), ([0.0, 0.0], "2 numbers, must be 1")],
)
def test_a_hand_that_cannot_be_is_refused(session, position, words):
    with pytest.raises(UsageError, match=words):
        session.operator.move(position)


def test_settings_and_marks_reach_the_master_and_all_who_listen(session, lines):
    assert session.set("master.force.scale", 0.3) == "force.scale = 0.3"
    with pytest.raises(UsageError, match="must be"):
        session.set("force.scale", -1.0)
    session.events()
    session.mark("trial 3 begins")
    end_s = time.monotonic() + 5.0
    while not any("trial" in line for line in lines) and time.monotonic() < end_s:
        time.sleep(0.01)
    assert any("mark: trial 3 begins" in line for line in lines)
    assert ("master", "mark: trial 3 begins") in session.events()
    for text in ("x" * 300, "two\nlines"):
        with pytest.raises(UsageError, match="one line"):
            session.mark(text)


def test_a_button_of_the_hand_is_an_answer(session):
    design = Design(procedure=ConstantStimuli((1.0,), 1), intervals=2)
    observer = ButtonObserver(design, {2: "1", 3: "2"}, "Which was stiffer?")
    session.operator.press(3)  # before the question
    time.sleep(0.5)
    observer.session = session
    presses = [threading.Timer(0.5 * k, session.operator.press, (n,)) for k, n in ((1, 7), (2, 2))]
    for press in presses:
        press.start()
    assert observer(design.begin(1).choose_trial()) == "1"
    for press in presses:
        press.join()
    with pytest.raises(TeleopError, match=r"no button was pressed within 0\.2 s"):
        session.wait_for_button((2, 3), timeout=0.2)
    presses = [text for source, text in session.events() if text.startswith("button")]
    assert presses == ["button 3 pressed", "button 7 pressed", "button 2 pressed"]


def test_it_is_stopped_and_the_stop_is_reset(engaged):
    engaged.emergency_stop("a test")
    engaged.wait_for("stopped", timeout=5.0)
    engaged.reset_stop()
    engaged.wait_for("ready", timeout=5.0)
    engaged.operator.engage()
    engaged.wait_for("engaged")


def test_another_program_joins_it(session):
    with join_session(session.name) as other:
        assert len(list(other.states(0.5))) > 30
        assert other.set("force.scale", 0.2) == "force.scale = 0.2"
        other.wait_for("ready")
        with pytest.raises(TeleopError, match=r"not fault within 0.3 s: the master is ready"):
            other.wait_for("fault", timeout=0.3)
        with pytest.raises(UsageError, match="allowed are off, ready"):
            other.wait_for("engagd")
        with pytest.raises(UsageError, match="allowed are command, state"):
            next(other.blocks(topic="forces"))


def test_a_program_that_does_not_leave_it_ends_all_the_same(session):
    words = [
        sys.executable,
        "-c",
        f"import teleop; teleop.join_session({session.name!r}).__enter__()",
    ]
    run = subprocess.run(words, check=False, timeout=30, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
