"""Driving a rig through the procedure: what goes wrong on the way, and several joints."""

import errno
import os

import numpy as np
import pytest

from slave.calibration.procedure_state import Phase
from slave.calibration.run import CalibrationInterrupted, CalibrationRefused
from slave.gate import GateConfig
from slave.rig import RigFault, RigSample
from teleop.errors import TeleopError, UsageError
from tests.slave.calibration.calibration_bench import (
    GATE,
    QUICK,
    HousingOnly,
    but,
    calibrated,
    effect,
    joint,
    rig_config,
)

SHORT = joint(body={"stops": (-0.003, 0.003)})


class Odd(HousingOnly):
    """A rig with something wrong from a time on."""

    def __init__(self, *joints, at=2.0, read=None, write=None, change=None):
        super().__init__(rig_config(*joints))
        self.at, self.time_s = at, 0.0
        self.bad_read, self.bad_write, self.change = read, write, change
        self.after_fault = 0

    def read(self, time_s):
        self.time_s = time_s
        samples = super().read(time_s)
        if time_s < self.at:
            return samples
        if self.bad_read is not None:
            self.after_fault += 1
            raise self.bad_read
        return tuple(map(self.change, samples)) if self.change else samples

    def write(self, proximal_displacement):
        if self.time_s >= self.at and self.bad_write is not None:
            self.after_fault += 1
            raise self.bad_write
        super().write(proximal_displacement)


def resting(rig, seconds=0.2):
    """Return whether the motors of a rig were told to stay, at low tensions, in the end."""
    last = np.array(rig.written[-round(500 * seconds) :])
    tension = rig.seen[-1].proximal_tension
    return bool(np.ptp(last[-20:], axis=0).max() == 0.0) and bool((tension < 1.5).all())


def test_a_rig_that_fails_ends_it_at_once_and_is_not_asked_again():
    for rig in (Odd(SHORT, read=RigFault("amplifier")), Odd(SHORT, write=RigFault("amplifier"))):
        with pytest.raises(TeleopError, match=r"^rig: amplifier$") as error:
            calibrated(rig, rate_hz=500.0)
        assert not isinstance(error.value, CalibrationRefused)
        assert rig.after_fault == 1


class Enabling(HousingOnly):
    """A rig whose motors follow from `AT_S` on; until then the tendons draw them back slowly."""

    AT_S, DRAWN = 0.5, -0.0004  # [s], [m/s]
    follows = False

    def __init__(self, *joints):
        super().__init__(rig_config(*joints))
        self.measured, self.held = [], []

    def read(self, time_s):
        self.follows = bool(self.written) and time_s > self.AT_S
        if not self.follows:
            self.rig.write(np.full(self.tendons, self.DRAWN * time_s))
        samples = super().read(time_s)
        self.measured += [s.proximal_displacement.tolist() for s in samples]
        return samples

    def write(self, proximal_displacement):
        if self.follows:
            super().write(proximal_displacement)
            return
        self.written.append(proximal_displacement.tolist())
        self.held.append((self.written[-1], self.measured[-1]))


@pytest.mark.parametrize("at_s", [0.2, 1.0])
def test_motors_that_are_being_enabled_are_held_where_they_are(at_s):
    rig = Enabling(SHORT)

    def stopped():
        return "enough" if rig.seen and rig.seen[-1].time_s >= at_s else ""

    with pytest.raises(CalibrationInterrupted, match="enough"):
        calibrated(rig, rate_hz=500.0, stopped=stopped)
    written, measured = np.array(rig.held).swapaxes(0, 1)
    assert len(written) >= 0.9 * min(at_s, Enabling.AT_S) * 500.0
    assert written == pytest.approx(measured, abs=1e-12)
    assert np.abs(np.diff(rig.written, axis=0)).max() <= GATE.speed_max / 500.0 * 1.01


def lost(sample):
    return RigSample(sample.time_s, sample.proximal_tension * np.nan, sample.proximal_displacement)


def blind(sample):
    return RigSample(sample.time_s, sample.proximal_tension, None)


@pytest.mark.parametrize("change", [lost, blind])
def test_without_any_reading_nothing_is_ever_written(change):
    rig = Odd(SHORT, at=0.0, change=change)
    with pytest.raises(CalibrationRefused, match="no tension and travel"):
        calibrated(rig, rate_hz=500.0)
    assert rig.written == []


def test_the_operator_ends_it_and_the_tensions_are_let_down():
    rig = HousingOnly(rig_config(SHORT))
    tension = []

    def stopped():
        tension.append(rig.seen[-1].proximal_tension.max() if rig.seen else 0.0)
        return "SIGINT: stopped" if max(tension) > 15.0 else ""

    with pytest.raises(CalibrationInterrupted, match="SIGINT") as error:
        calibrated(rig, rate_hz=500.0, stopped=stopped)
    assert error.value.exit_code == 130
    assert resting(rig)
    end = int(np.argmax(np.array(tension) > 15.0))
    written = np.array(rig.written)
    assert (np.diff(written[end:], axis=0) <= 1e-15).all()  # paid out, never pulled


def test_a_terminal_that_is_gone_ends_it_and_the_tensions_are_let_down():
    rig = HousingOnly(rig_config(SHORT))
    tension = []

    def progress(_):
        tension.append(rig.seen[-1].proximal_tension.max())
        if tension[-1] > 15.0:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    with pytest.raises(CalibrationInterrupted, match=r"cannot be printed \(Input/output error\)"):
        calibrated(rig, rate_hz=500.0, progress=progress)
    assert tension[-1] > 15.0
    assert resting(rig)


class Watched(HousingOnly):
    """A rig whose driver waits for its loop; counts what was written before each pause."""

    def __init__(self, fault=None):
        super().__init__(rig_config(SHORT))
        self.pauses, self.fault = [], fault

    def announce_pause(self):
        if self.fault is not None:
            raise self.fault
        self.pauses.append(len(self.written))


def test_a_rig_that_watches_its_loop_is_told_of_the_pause_after_the_last_position():
    rig = Watched()
    calibrated(rig, rate_hz=500.0)
    assert rig.pauses == [len(rig.written)]


def test_a_driver_that_fails_at_the_pause_ends_it_with_its_words():
    with pytest.raises(TeleopError, match=r"^rig: the driver's process has ended$"):
        calibrated(Watched(RigFault("the driver's process has ended")), rate_hz=500.0)


def test_after_a_refusal_the_tensions_are_let_down_and_the_motors_hold():
    rig = HousingOnly(rig_config(joint(range=12.0)))
    with pytest.raises(CalibrationRefused):
        calibrated(rig, rate_hz=500.0)
    assert resting(rig)


# What the config forbids is said before anything moves.


@pytest.mark.parametrize(
    ("initialise", "gate", "said"),
    [
        (QUICK, GateConfig(tension_max=15.0), "slave.initialise.tension: 20 N is over slave.gate"),
        (QUICK, GateConfig(speed_max=0.01), "seek_speed: 0.02 m/s is over slave.gate.speed_max"),
        (but(QUICK, sheaths=QUICK.sheaths * 3), GATE, "sheaths: 3 sheaths, but the rig has 2"),
    ],
)
def test_a_config_that_cannot_be_is_refused(initialise, gate, said):
    rig = HousingOnly(rig_config(SHORT))
    with pytest.raises(UsageError, match=said):
        calibrated(rig, initialise, gate)
    assert rig.written == []


def test_a_gate_that_is_too_narrow_is_named():
    rig = rig_config(joint())
    with pytest.raises(CalibrationRefused, match=r"tendon [ab]: .*slave.gate.displacement_m"):
        calibrated(rig, gate=GateConfig(displacement_min=-0.004, displacement_max=0.06))
    with pytest.raises(CalibrationRefused, match=r"tendon a: .*slave.gate.displacement_max"):
        calibrated(rig, gate=GateConfig(displacement_min=-0.06, displacement_max=0.004))


# Several joints.


def moved(record, tendons):
    return np.ptp(record.travel[:, tendons], axis=0).min()


def test_joints_are_done_one_after_another_while_the_others_hold():
    rig = HousingOnly(rig_config(SHORT, SHORT))
    found = calibrated(rig, rate_hz=500.0)
    assert list(found.motor) == rig.written[-1]  # where they are held from then on
    record = found.record
    first = record.phase[:, 1] == Phase.TAKE_UP
    first &= np.arange(len(first)) < np.argmax(record.phase[:, 0] == Phase.DONE)
    assert np.ptp(record.travel[first][:, [2, 3]], axis=0).max() < 1e-4
    second = record.phase[:, 0] == Phase.DONE
    assert np.ptp(record.travel[second][:, [0, 1]], axis=0).max() < 1e-4
    assert [len(stops) for stops in record.stops] == [2, 2]


def test_together_they_take_as_long_as_one():
    one = calibrated(rig_config(SHORT), rate_hz=500.0).record.time
    both = calibrated(rig_config(SHORT, SHORT), rate_hz=500.0, together=True).record
    assert both.time[-1] < 1.1 * one[-1]
    assert [len(stops) for stops in both.stops] == [2, 2]


def test_one_that_is_refused_ends_the_others_too():
    config = rig_config(SHORT, SHORT, effects=(effect("broken_tendon", joint=2, start=1.0),))
    rig = HousingOnly(config)
    with pytest.raises(CalibrationRefused, match="joint 2"):
        calibrated(rig, rate_hz=500.0, together=True)
    assert resting(rig)


def test_joints_that_were_not_asked_for_stay():
    record = calibrated(rig_config(SHORT, SHORT), rate_hz=500.0, joints=[1]).record
    assert moved(record, [2, 3]) > 0.005
    assert np.ptp(record.travel[:, [0, 1]], axis=0).max() < 1e-4
    assert [len(stops) for stops in record.stops] == [0, 2]
