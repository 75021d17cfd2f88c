"""Driving a rig through the procedure: what goes wrong on the way, and several joints."""

import errno
import math
import os
import re

import numpy as np
import pytest

from slave.calibration.procedure_run import CalibrationInterrupted, CalibrationRefused
from slave.calibration.procedure_state import Phase
from slave.gate import GateConfig
from slave.rig import RigFault, RigSample
from slave.simulation.motor import MotorConfig
from teleop.errors import TeleopError, UsageError
from tests.slave.calibration.calibration_bench import (
    EA,
    GATE,
    LENGTH,
    QUICK,
    HousingOnly,
    but,
    calibrated,
    effect,
    joint,
    rig_config,
)

SHORT = joint(body={"stops": (-0.003, 0.003)})
RATE = 500.0  # [Hz]
STRETCH = QUICK.tension * LENGTH / EA  # [m] of a tendon without friction at the tension pulled to


class Failing(HousingOnly):
    """A rig that fails `delay` seconds after a phase began, or after its start."""

    def __init__(self, config, phase=None, delay=2.0, read=None, write=None):
        super().__init__(config)
        self.phase, self.delay, self.bad_read, self.bad_write = phase, delay, read, write
        self.time_s, self.begun = 0.0, 0.0 if phase is None else math.inf
        self.healthy = 0  # writes before it failed

    @property
    def failed(self):
        return self.time_s >= self.begun + self.delay

    def follow(self, progress):
        if progress.phase is self.phase:
            self.begun = min(self.begun, self.time_s)

    def read(self, time_s):
        self.time_s = time_s
        samples = super().read(time_s)
        return self.bad_read(samples) if self.failed and self.bad_read else samples

    def write(self, proximal_displacement):
        super().write(proximal_displacement)
        if not self.failed:
            self.healthy = len(self.written)
        elif self.bad_write:
            self.rig.write(self.bad_write(self, proximal_displacement))

    def since(self):
        """Return the motors' travel [m] as it was written, from the last healthy tick on."""
        written = np.array(self.written[self.healthy - 1 :])
        return written - written[0]


def refused(rig, **initialise):
    with pytest.raises(CalibrationRefused) as error:
        calibrated(rig, but(QUICK, **initialise), rate_hz=RATE, progress=rig.follow)
    return str(error.value)


def changed(samples, tension=None, travel=None):
    return tuple(
        RigSample(
            s.time_s,
            s.proximal_tension if tension is None else np.full(2, tension),
            s.proximal_displacement if travel is None else travel,
        )
        for s in samples
    )


def lost(samples):
    return changed(samples, tension=math.nan)


def blind(samples):
    return changed(samples, travel=np.full(2, math.nan))


def silent(_samples):
    return ()


def stuck(samples):
    return changed(samples, tension=QUICK.tension)


@pytest.mark.parametrize("read", [lost, pytest.param(silent, marks=pytest.mark.slow)])
def test_a_pull_goes_no_further_than_its_last_reading_allows(read):
    rig = Failing(rig_config(joint()), Phase.SEEK, 0.2, read)
    refused(rig)
    ahead = rig.since()[:, 0].max()
    assert 0.0 < ahead <= QUICK.seek_speed * (GATE.tension_age_max + 1.0 / RATE)


@pytest.mark.parametrize(("read", "phase"), [(lost, Phase.RELEASE), (stuck, Phase.SEEK)])
def test_letting_go_without_a_reading_takes_what_a_tendon_stretches_and_ends(read, phase):
    rig = Failing(rig_config(joint()), phase, 0.02, read)
    refused(rig)
    paid_out = -rig.since()[:, 0]
    assert STRETCH < paid_out[-1] < 3.0 * STRETCH
    assert rig.seen[-1].proximal_tension[0] < QUICK.take_up
    assert np.ptp(rig.since()[-100:], axis=0).max() == 0.0


def weak(newtons):
    """Return a joint whose motors cannot pull harder than that, with rotors as light as that."""
    bent, motor = joint(), MotorConfig(rotor_inertia=1e-7)
    winds = motor.pulley_radius / motor.gear
    motor = but(motor, peak_torque=newtons * winds / motor.efficiency)
    return but(bent, tendons=tuple(but(tendon, motor=motor) for tendon in bent.tendons))


def test_a_motor_too_weak_for_the_tension_is_named_and_not_asked_for_more():
    rig = HousingOnly(rig_config(weak(8.0), period=1e-3))
    with pytest.raises(CalibrationRefused) as error:
        calibrated(rig, rate_hz=RATE)
    said = re.fullmatch(
        r"joint 1, tendon a: the motor is 3\.\d mm behind its command at (\d\.\d) N; check that it "
        r"can pull 20 N, or lower slave\.initialise\.tension",
        str(error.value),
    )
    assert said
    assert float(said[1]) == pytest.approx(8.0, abs=0.5)
    assert_followed(rig, 0)


@pytest.mark.parametrize(
    ("stands", "name"), [(0, "a"), pytest.param(1, "b", marks=pytest.mark.slow)]
)
def test_a_motor_that_stands_still_is_named_whichever_way_it_should_go(stands, name):
    def hold(rig, asked):
        return np.where(np.arange(2) == stands, rig.written[rig.healthy - 1], asked)

    rig = Failing(rig_config(joint()), Phase.SEEK, 0.2, write=hold)
    assert refused(rig).startswith(f"joint 1, tendon {name}: the motor is 3.0 mm behind")
    assert_followed(rig, stands)


def assert_followed(rig, tendon):
    """Check that a motor was asked for `lag_max` more than it went, and a tick, at most."""
    went = max(s.proximal_displacement[tendon] for s in rig.seen)
    asked = max(written[tendon] for written in rig.written)
    assert asked - went <= QUICK.lag_max + 2.0 * QUICK.seek_speed / RATE


def test_a_phase_that_does_not_end_is_given_up():
    rig = HousingOnly(rig_config(joint()))
    with pytest.raises(
        CalibrationRefused, match=r"joint 1: seeking the stop took longer than 1 s; .*phase_max"
    ):
        calibrated(rig, but(QUICK, seek_speed=0.002, phase_max=1.0), rate_hz=RATE)
    went = np.array(rig.written).max(axis=0)
    assert went.max() < QUICK.slack_max


def resting(rig, seconds=0.2):
    """Return whether the motors of a rig were told to stay, at low tensions, in the end."""
    last = np.array(rig.written[-round(RATE * seconds) :])
    tension = rig.seen[-1].proximal_tension
    return bool(np.ptp(last[-20:], axis=0).max() == 0.0) and bool((tension < 1.5).all())


def test_a_rig_that_fails_ends_it_at_once_and_is_not_asked_again():
    asked = []

    def fail(*_):
        asked.append(True)
        raise RigFault("amplifier")

    for how in ({"read": fail}, {"write": fail}):
        asked.clear()
        with pytest.raises(TeleopError, match=r"^rig: amplifier$") as error:
            calibrated(Failing(rig_config(SHORT), **how), rate_hz=RATE)
        assert not isinstance(error.value, CalibrationRefused)
        assert asked == [True]


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


def test_motors_that_are_being_enabled_are_held_where_they_are():
    at_s = 1.0
    rig = Enabling(SHORT)

    def stopped():
        return "enough" if rig.seen and rig.seen[-1].time_s >= at_s else ""

    with pytest.raises(CalibrationInterrupted, match="enough"):
        calibrated(rig, rate_hz=RATE, stopped=stopped)
    written, measured = np.array(rig.held).swapaxes(0, 1)
    assert len(written) >= 0.9 * min(at_s, Enabling.AT_S) * RATE
    assert written == pytest.approx(measured, abs=1e-12)
    assert np.abs(np.diff(rig.written, axis=0)).max() <= GATE.speed_max / RATE * 1.01


@pytest.mark.parametrize("read", [lost, blind])
def test_without_any_reading_nothing_is_ever_written(read):
    rig = Failing(rig_config(SHORT), delay=0.0, read=read)
    with pytest.raises(CalibrationRefused, match="no tension and travel"):
        calibrated(rig, rate_hz=RATE)
    assert rig.written == []


def test_the_operator_ends_it_and_the_tensions_are_let_down():
    rig = HousingOnly(rig_config(SHORT))
    tension = []

    def stopped():
        tension.append(rig.seen[-1].proximal_tension.max() if rig.seen else 0.0)
        return "SIGINT: stopped" if max(tension) > 15.0 else ""

    with pytest.raises(CalibrationInterrupted, match="SIGINT") as error:
        calibrated(rig, rate_hz=RATE, stopped=stopped)
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
        calibrated(rig, rate_hz=RATE, progress=progress)
    assert tension[-1] > 15.0
    assert resting(rig)


class Watched(HousingOnly):
    """A rig whose driver waits for its loop; counts what was written before each pause."""

    def __init__(self, config):
        super().__init__(config)
        self.pauses = []

    def announce_pause(self):
        self.pauses.append(len(self.written))


# What the config forbids is said before anything moves.


@pytest.mark.parametrize(
    ("initialise", "gate", "said"),
    [
        (QUICK, GateConfig(tension_max=15.0), "slave.initialise.tension: 20 N is over slave.gate"),
        (QUICK, GateConfig(speed_max=0.01), "seek_speed: 0.02 m/s is over slave.gate.speed_max"),
        (but(QUICK, sheaths=QUICK.sheaths * 3), GATE, "sheaths: 3 sheaths, but the rig has 2"),
        (but(QUICK, range=(0.03, 0.03)), GATE, "range: 2 entries, but the rig has 1"),
    ],
)
def test_a_config_that_cannot_be_is_refused(initialise, gate, said):
    rig = HousingOnly(rig_config(SHORT))
    with pytest.raises(UsageError, match=said):
        calibrated(rig, initialise, gate)
    assert rig.written == []


# Several joints.


def moved(record, tendons):
    return np.ptp(record.travel[:, tendons], axis=0).min()


def test_joints_are_done_one_after_another_while_the_others_hold():
    rig = Watched(rig_config(SHORT, SHORT))
    found = calibrated(rig, rate_hz=RATE)
    assert rig.pauses == [len(rig.written)]  # told after the last position
    assert list(found.motor) == rig.written[-1]  # where they are held from then on
    record = found.record
    first = record.phase[:, 1] == Phase.TAKE_UP
    first &= np.arange(len(first)) < np.argmax(record.phase[:, 0] == Phase.DONE)
    assert np.ptp(record.travel[first][:, [2, 3]], axis=0).max() < 1e-4
    second = record.phase[:, 0] == Phase.DONE
    assert np.ptp(record.travel[second][:, [0, 1]], axis=0).max() < 1e-4
    assert [len(stops) for stops in record.stops] == [2, 2]


def test_one_that_is_refused_ends_the_others_too():
    config = rig_config(SHORT, SHORT, effects=(effect("broken_tendon", joint=2, start=1.0),))
    rig = HousingOnly(config)
    with pytest.raises(CalibrationRefused, match="joint 2"):
        calibrated(rig, rate_hz=RATE, together=True)
    assert resting(rig)


@pytest.mark.slow
def test_joints_that_were_not_asked_for_stay():
    record = calibrated(rig_config(SHORT, SHORT), rate_hz=RATE, joints=[1]).record
    assert moved(record, [2, 3]) > 0.005
    assert np.ptp(record.travel[:, [0, 1]], axis=0).max() < 1e-4
    assert [len(stops) for stops in record.stops] == [0, 2]
