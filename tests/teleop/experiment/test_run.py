"""Experiments in sessions: what is set, marked and kept; what cannot be set is refused at once."""

import os
import pty
import select
import sys
import time
from contextlib import suppress

import numpy as np
import pytest

from teleop import (
    ButtonObserver,
    ConstantStimuli,
    Design,
    Experiment,
    KeyObserver,
    TeleopError,
    UsageError,
    load_config,
    read_trials,
    run_experiment,
)
from teleop.messages.messages import Event, decode_text
from teleop.recording.reader import read_messages
from tests.root import ROOT

DEMO = ROOT / "configs" / "demo.yaml"
SLOW = {"rate_hz": 250.0, "slave.command_timeout": 0.5, "master.state_timeout": 0.5,
        "master.delay_max": 1.0, "realtime.priority": 0}  # fmt: skip
LEVELS = ConstantStimuli((0.0, 1.0), 2)
STIFFNESS = "slave.rig.joints.0.environment.stiffness"


def set_force(trial, interval):
    return {"force.scale": 0.1 * (1.0 + trial.stimulus * (interval == trial.target))}


def run(config, folder, **words):
    experiment = Experiment(name="test", **{"duration": 0.3} | words)
    lines = []
    observer = lambda trial: str(trial.target)  # noqa: E731
    run_experiment(config, experiment, 1, folder, observer, engage_timeout=20.0, say=lines.append)
    return lines


@pytest.mark.real_time
def test_trials_take_place_in_one_session_and_are_marked_in_its_recording(tmp_path):
    """The hand holds on, whatever the stiffness that a condition sets."""
    engage = {"master.device.engage": [[0.5, 1000.0]], "master.device.engage_period": 1001.0}
    factors = {"impair.to_slave.delay": (0.01,), STIFFNESS: (2000.0, 12_000.0)}
    design = Design(factors=factors, procedure=ConstantStimuli((0.0, 1.0), 1), intervals=2, seed=2)
    lines = run(load_config(DEMO, SLOW | engage), tmp_path, design=design, set_stimulus=set_force)
    rows = read_trials(tmp_path)
    assert [row["correct"] for row in rows] == ["1"] * 4
    assert {float(row[STIFFNESS]) for row in rows} == {2000.0, 12_000.0}
    abandoned = sum("abandoned and repeated" in line for line in lines)
    assert sum(int(row["attempts"]) for row in rows) == 4 + abandoned <= 5
    assert sum("a session starts" in line for line in lines) == 1
    (recording,) = (tmp_path / "recordings").glob("*.mcap")
    assert {row["recording"] for row in rows} == {recording.name}
    events = [
        (message.log_time_ns, decode_text(Event.unpack(message.data).text))
        for message in read_messages(recording, topics=("event",))
    ]
    marks = [(stamp, text) for stamp, text in events if text.startswith("mark: trial ")]
    for row in rows:
        number = row["trial"]
        begins = [stamp for stamp, text in marks if text.startswith(f"mark: trial {number} begins")]
        assert min(abs(stamp - int(row["begin_stamp_ns"])) for stamp in begins) < 0.5e9
        wanted = f"stimulus={row['stimulus']}, target={row['target']}"
        assert all(wanted in text for _, text in marks if f"trial {number} begins" in text)
        end = f"mark: trial {number} ends: response={row['response']}"
        assert [text for _, text in marks].count(end) == 1
    assert sum(" abandoned: " in text for _, text in marks) == abandoned
    assert any("force.scale" in text and "0.2" in text for _, text in events)
    wanted = [f"set: {STIFFNESS} = {float(row[STIFFNESS]):g}" for row in rows]
    changes = [text for k, text in enumerate(wanted) if k == 0 or wanted[k - 1] != text]
    assert [text for _, text in events if text.startswith("set: slave")] == changes


@pytest.mark.real_time
def test_a_scripted_hand_that_lets_go_for_good_ends_the_experiment_and_keeps_its_trials(tmp_path):
    config = load_config(DEMO, SLOW | {"master.device.engage": [[0.5, 2.0]],
                                       "master.device.engage_period": 1000.0})  # fmt: skip
    experiment = Experiment(name="test", design=Design(procedure=ConstantStimuli((0.0,), 100)),
                            duration=0.3)  # fmt: skip
    lines = []
    with pytest.raises(
        TeleopError, match=r"is not engaged within 1 s: .*, 2 times in a row"
    ) as why:
        run_experiment(config, experiment, 1, tmp_path, lambda _: "no", engage_timeout=1.0,
                       say=lines.append)  # fmt: skip
    assert "earlier trials are kept" in str(why.value)
    assert "\n" not in str(why.value)
    assert 1 <= len(read_trials(tmp_path)) < 100
    assert 1 <= sum("abandoned and repeated" in line for line in lines) <= 2


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ({"set_stimulus": lambda *_: {"coupling.type": "direct"}},
         "coupling.type cannot change while a session runs; make it a factor"),
        ({"set_stimulus": lambda _, i: {"force.scale": 0.1} if i == 1 else {}},
         "master.force.scale: must be set in every condition and interval"),
        ({"set_stimulus": lambda *_: {"force.scale": -1.0}}, "scale: -1.0: must be 0 to 10"),
        ({"design": Design(factors={"slave.rig.mass": (1,)}, procedure=LEVELS)}, "mass"),
    ],
)  # fmt: skip
def test_settings_that_cannot_be_are_refused_before_a_session_starts(tmp_path, words, line):
    with pytest.raises(UsageError, match=line) as caught:
        run(DEMO, tmp_path, **{"design": Design(procedure=LEVELS, intervals=2)} | words)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "recordings").exists()


ASKING = """
import termios
from teleop import ConstantStimuli, Design, KeyObserver

design = Design(procedure=ConstantStimuli((0.0, 1.0), 2), intervals=2)
input("name? ")
print("answer", KeyObserver(design, "Which was stiffer?")(design.begin(1).choose_trial()))
print("echo", bool(termios.tcgetattr(0)[3] & termios.ECHO))
"""


def test_a_key_of_the_terminal_is_an_answer():
    """In a terminal of its own; keys before the question do not count, and none is shown."""
    pid, keys = pty.fork()
    if pid == 0:
        os.chdir(ROOT)
        os.execv(sys.executable, [sys.executable, "-c", ASKING])  # noqa: S606
    shown, named, end = b"", False, time.monotonic() + 60.0
    try:
        with suppress(OSError):  # the terminal is closed at the end
            while time.monotonic() < end:
                if not select.select([keys], [], [], 0.3)[0]:
                    if b"[1/2]" in shown:  # until it listens
                        os.write(keys, b"x2")
                    continue
                text = os.read(keys, 1024)
                if not text:
                    break
                shown += text
                if not named and shown.endswith(b"name? "):
                    named = True
                    os.write(keys, b"me\n1")
    finally:
        os.close(keys)  # which hangs up on a child that still waits
        _, status = os.waitpid(pid, 0)
    assert status == 0, shown
    answers = shown.partition(b"1: Which was stiffer? [1/2]\r\n")[2]
    assert answers.split()[:4] == [b"answer", b"2", b"echo", b"True"]


def test_buttons_give_only_answers_of_the_design_and_need_a_session(tmp_path):
    design = Design(procedure=LEVELS, intervals=2)
    with pytest.raises(UsageError, match="answer '3': allowed are 1, 2"):
        ButtonObserver(design, {2: "1", 3: "3"})
    with pytest.raises(UsageError, match="no button has an answer"):
        ButtonObserver(design, {})
    experiment = Experiment(name="test", design=design)
    with pytest.raises(UsageError, match="needs a session"):
        run_experiment(None, experiment, 1, tmp_path, ButtonObserver(design, {2: "1", 3: "2"}))


def test_without_a_terminal_there_are_no_keys(monkeypatch):
    with open(os.devnull) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        design = Design(procedure=LEVELS)
        with pytest.raises(UsageError, match="no terminal"):
            KeyObserver(design)(design.begin(1).choose_trial())


def test_a_design_without_a_session_asks_for_each_condition(tmp_path):
    design = Design(factors={"a": (1, 2, 3)}, repetitions=2)
    experiment = Experiment(name="test", design=design)
    observer = lambda trial: f"rated {trial.condition['a']}"  # noqa: E731
    rows = read_trials(run_experiment(None, experiment, 1, tmp_path, observer, say=lambda _: None))
    assert len(rows) == 6
    assert all(row["response"] == f"rated {row['a']}" and not row["correct"] for row in rows)
    assert np.all(np.bincount([int(row["a"]) for row in rows])[1:] == 2)
