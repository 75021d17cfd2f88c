"""`teleop rig`: what is read, what is moved and how far, and what is said of wrong wiring."""

import argparse
from functools import partial

import numpy as np
import pytest

from slave.bring_up import command
from slave.bring_up.rig_check import (
    GatedRig,
    MotorMove,
    evaluate_move,
    format_rest_measurement,
    measure_at_rest,
    move_motor,
)
from slave.calibration.procedure_run import generate_fast_ticks
from slave.drivers import driver_table
from slave.drivers.cia402.config import Cia402Config
from slave.drivers.driver import Channels, DriverFault
from slave.gate import GateConfig
from slave.rig import RigSample
from slave.rigs.hardware import HardwareRig
from teleop.errors import TeleopError, UsageError
from teleop.runtime.clock import Grid
from tests.tick.clock import StandingClock

MOVE = MotorMove(0.5e-3, 2.0)


class Wired:
    """Two springs of 2000 N/m under motors that follow at once; wired as told."""

    name, tendons, joints, starts_at_zero = "wired", 2, ((0, 1),), False

    def __init__(self, cells=(0, 1), sign=1.0, gain=1.0, stiffness=2000.0, cross_talk=0.0):
        self.cells, self.sign, self.gain, self.stiffness = cells, sign, gain, stiffness
        self.cross_talk = np.array([[1.0, 0.0], [cross_talk, 1.0]])  # of cell 1 in cell 2
        self.start = np.array([0.004, -0.001])
        self.position, self.writes, self.closed = self.start.copy(), [], False
        self.random = np.random.default_rng(2)

    def read(self, time_s):
        pulled = self.sign * self.stiffness * (self.position - self.start)
        tension = self.cross_talk @ pulled[list(self.cells)]
        noise = self.random.normal(0.0, 0.01, 2)
        return (RigSample(time_s, 3.0 + tension + noise, self.position.copy()),)

    def write(self, proximal_displacement):
        self.writes.append(proximal_displacement)
        self.position = self.start + self.gain * (proximal_displacement - self.start)

    def advance(self): ...

    def summarise(self):
        return {}

    def close(self):
        self.closed = True


def moved(rig, tendon=0, move=MOVE):
    ticks = generate_fast_ticks(500.0)
    rest = measure_at_rest(rig, ticks, 0, 0.5)
    mover = GatedRig(rig, GateConfig(), ticks, 0, rest)
    return evaluate_move(move_motor(mover, rest, tendon, move), rest)


class Enabling(Wired):
    """Its motors follow after 50 writes; until then the tendons draw them on."""

    follows = False

    def write(self, proximal_displacement):
        if self.follows:
            super().write(proximal_displacement)
            return
        self.writes.append(proximal_displacement)
        self.position = self.position + 1e-5
        self.follows = len(self.writes) == 50


def test_motors_that_are_being_enabled_are_held_where_they_are():
    rig, ticks = Enabling(), generate_fast_ticks(500.0)
    rest = measure_at_rest(rig, ticks, 0, 0.5)
    mover = GatedRig(rig, GateConfig(), ticks, 0, rest)
    mover.enable()
    assert len(rig.writes) == 50
    drawn = rig.start + 1e-5 * np.arange(50)[:, np.newaxis]
    assert np.abs(np.array(rig.writes) - drawn).max() <= 1e-5 * 1.01
    mover.run(0.1, mover.last)
    assert np.abs(np.diff(rig.writes, axis=0)).max() <= 1e-5 * 1.01


class Late(Wired):
    """Gives nothing for a while: its newest readings are of before the question."""

    SILENT, reads = 40, 0

    def read(self, time_s):
        self.reads += 1
        return () if self.reads <= self.SILENT else super().read(time_s)


def test_nothing_is_written_before_a_reading_of_the_same_tick():
    rig, ticks = Late(), generate_fast_ticks(500.0)
    rest = measure_at_rest(Wired(), ticks, 0, 0.5)
    rig.position = rig.start = rig.start + 0.0015
    mover = GatedRig(rig, GateConfig(), ticks, 0, rest)
    mover.enable()
    assert rig.writes == []
    mover.run(0.01, mover.last)
    assert rig.writes[0] == pytest.approx(rig.start, abs=1e-9)


def test_a_rig_that_falls_silent_before_its_motors_are_enabled_is_named():
    rig, ticks = Late(), generate_fast_ticks(500.0)
    rig.SILENT = 10_000
    rest = measure_at_rest(Wired(), ticks, 0, 0.5)
    with pytest.raises(TeleopError, match=r"no tension and travel of every tendon for 0\.5 s"):
        GatedRig(rig, GateConfig(), ticks, 0, rest).enable()
    assert rig.writes == []


def test_at_rest_rate_and_noise_are_told_and_nothing_is_written():
    rig = Wired()
    rest = measure_at_rest(rig, generate_fast_ticks(500.0), 0, 2.0)
    assert rest.rate_hz == pytest.approx(500.0)
    assert rest.tension_noise == pytest.approx(0.01, rel=0.2)
    assert len(format_rest_measurement(rest, GateConfig())) == 4
    assert rig.writes == []


@pytest.mark.parametrize("tendon", [0, 1])
def test_a_motor_moves_as_far_as_stated_and_comes_back_alone(tendon):
    rig = Wired()
    is_right, text = moved(rig, tendon)
    assert is_right, text
    writes = np.array(rig.writes) - rig.start
    assert writes[:, tendon].max() == pytest.approx(0.5e-3)
    assert np.abs(writes[:, 1 - tendon]).max() < 1e-12
    assert writes[0] == pytest.approx(0.0)
    assert writes[-1] == pytest.approx(0.0, abs=1e-9)
    assert np.abs(np.diff(writes[:, tendon])).max() <= 0.002 / 500.0 * 1.01


def test_it_pulls_no_further_than_the_force_that_is_stated():
    rig = Wired(stiffness=50_000.0)
    is_right, text = moved(rig)
    assert is_right, text
    assert (np.array(rig.writes) - rig.start).max() < (2.0 + 0.5) / 50_000.0


@pytest.mark.parametrize(
    ("wiring", "said"),
    [
        ({"sign": -1.0}, "the tension falls"),
        ({"cells": (1, 0)}, "the cell of tendon 2 answers in its place"),
        ({"gain": 0.0}, "does not follow"),
        ({"gain": -1.0}, "does not follow"),
        ({"stiffness": 0.0}, "no tension"),
    ],
)
def test_wrong_wiring_is_named(wiring, said):
    is_right, text = moved(Wired(**wiring))
    assert not is_right
    assert said in text


def test_a_cell_that_follows_another_motor_is_named_with_its_share():
    assert moved(Wired(cross_talk=0.1))[1].endswith(": right; the cell of tendon 2 follows by +10%"
        ": through their joint, or, if they have none in common, by cross-talk (converter switched "
        "too early?)")  # fmt: skip
    assert moved(Wired(cross_talk=0.1), tendon=1)[1].endswith(": right")


@pytest.fixture
def clock(monkeypatch):
    """Time of `teleop rig check` stands still but for sleeping."""
    clock = StandingClock(monkeypatch)
    monkeypatch.setattr(command, "Grid", partial(Grid, now=clock.now, sleep=clock.sleep))


def arguments(*words):
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return parser.parse_args(["check", "--duration", "0.3", "--set", "rate_hz=200", *words])


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize(("typed", "moves"), [("move", True), ("", False), ("yes", False)])
def test_nothing_moves_without_the_typed_word(monkeypatch, capsys, typed, moves):
    rig = Wired()
    monkeypatch.setattr(command, "open_rig", lambda *_: rig)
    assert command.check_rig(arguments(), lambda _: typed) == 0
    assert bool(rig.writes) is moves
    assert rig.closed
    assert ("next: teleop calibrate" if moves else "nothing was moved") in capsys.readouterr().out


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize(("displacement", "place"), [(-0.0175, "-17.5000"), (0.0613, "61.3000")])
def test_a_motor_that_has_lost_turns_is_named_and_nothing_is_moved(
    monkeypatch, capsys, displacement, place
):
    rig = Wired()
    rig.position = rig.start = np.array([0.004, displacement])
    monkeypatch.setattr(command, "open_rig", lambda *_: rig)
    with pytest.raises(TeleopError, match=r"outside slave\.gate .* nothing is moved"):
        command.check_rig(arguments(), lambda _: pytest.fail("asked"))
    first, second, named = capsys.readouterr().out.splitlines()[2:5]
    assert "4.0000" in first
    assert place in second
    assert "outside slave.gate (-5 to 60 mm): has its motor lost turns" in named
    assert rig.writes == []


class Measured(Wired, HardwareRig):
    """A rig with converters: the second cell is at the end of its one, of 24 bits."""

    counts = np.array([2048.0, 2048.0]), np.array([1200.0, -8388608.0])


@pytest.mark.usefixtures("clock")
def test_a_cell_that_is_saturated_is_named_and_nothing_is_moved(monkeypatch, capsys):
    rig = Measured()
    monkeypatch.setattr(command, "open_rig", lambda *_: rig)
    with pytest.raises(TeleopError, match=r"cell of tendon 2 is saturated .* nothing is moved"):
        command.check_rig(arguments(), lambda _: pytest.fail("asked"))
    first, second = capsys.readouterr().out.splitlines()[-2:]
    assert first == "tendon 1: motor at 2048, cell at 1200 counts"
    assert "cell at -8388608 counts, the end of its converter's range: overloaded, or" in second
    assert rig.writes == []


@pytest.mark.parametrize("words", [["--travel", "6"], ["--travel", "0"], ["--force", "nan"]])
def test_a_move_that_is_not_small_is_refused_before_the_rig_is_opened(monkeypatch, words):
    monkeypatch.setattr(command, "open_rig", lambda *_: pytest.fail("opened"))
    with pytest.raises(UsageError, match="must be above 0"):
        command.check_rig(arguments(*words), input)


def test_without_its_library_a_driver_says_in_a_line_what_to_install(monkeypatch):
    def missing(_name):
        raise ModuleNotFoundError("No module named 'can'", name="can")

    monkeypatch.setattr(driver_table, "importlib", argparse.Namespace(import_module=missing))
    with pytest.raises(DriverFault, match=r"'can': pip install 'tendon-teleop\[can\]'"):
        driver_table.open_driver(Cia402Config(), Channels((1,)))


def test_read_only_opens_the_rig_so_and_writes_nothing(monkeypatch):
    rig, opened = Wired(), []
    monkeypatch.setattr(command, "open_rig", lambda *words: opened.append(words) or rig)
    assert command.check_rig(arguments("--read-only"), lambda _: pytest.fail("asked")) == 0
    assert (opened[0][1], rig.writes, rig.closed) == (True, [], True)
