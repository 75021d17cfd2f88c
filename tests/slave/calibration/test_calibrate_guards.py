"""What keeps a calibration from pulling on, or paying out, when it must no longer."""

import math
import re

import numpy as np
import pytest

from slave.calibration.procedure_state import Phase
from slave.calibration.run import CalibrationRefused
from slave.rig import RigSample
from slave.simulation.motor import MotorConfig
from tests.slave.calibration.calibration_bench import (
    EA,
    GATE,
    LENGTH,
    QUICK,
    HousingOnly,
    but,
    calibrated,
    joint,
    rig_config,
)

RATE = 500.0  # [Hz]
STRETCH = QUICK.tension * LENGTH / EA  # [m] of a tendon without friction at the tension pulled to


class Failing(HousingOnly):
    """A rig that fails when the procedure has been in a phase for `delay` seconds."""

    def __init__(self, config, phase, delay, read=None, write=None):
        super().__init__(config)
        self.phase, self.delay, self.bad_read, self.bad_write = phase, delay, read, write
        self.time_s, self.begun = 0.0, math.inf
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


@pytest.mark.parametrize("read", [lost, blind, silent])
def test_a_pull_goes_no_further_than_its_last_reading_allows(read):
    rig = Failing(rig_config(joint()), Phase.SEEK, 0.2, read)
    refused(rig)
    ahead = rig.since()[:, 0].max()
    assert 0.0 < ahead <= QUICK.seek_speed * (GATE.tension_age_max + 1.0 / RATE)


@pytest.mark.parametrize(
    ("read", "phase"), [(lost, Phase.RELEASE), (silent, Phase.RELEASE), (stuck, Phase.SEEK)]
)
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
    rig = HousingOnly(rig_config(weak(8.0)))
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


@pytest.mark.parametrize(("stands", "name"), [(0, "a"), (1, "b")])
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
