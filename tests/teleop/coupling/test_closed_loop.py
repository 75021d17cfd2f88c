"""Live master and slave over a bad network: what is stable, what settles, and what does not."""

import math

import numpy as np
import pytest

from studies.transparency import zwidth
from studies.transparency.hand import DT, Arm, Device, HandModel
from studies.transparency.hand import build_reach as reaching
from studies.transparency.rig import Rig, build_wall, press_nothing, press_tissue
from studies.transparency.system import SETTLED, Network, Teleoperator, build_settings, run_hand
from teleop.coupling import Bilateral, DirectConfig, PassivityConfig, WaveConfig
from teleop.session import state_machine
from teleop.session.state_machine import Reason, State

ROUND_TRIPS = [0.0, 0.020, 0.100, 0.200, 0.300]  # [s]
MET = {
    "free": press_nothing,
    "tissue": press_tissue,
    "wall": build_wall(2000.0),
    "hard wall": build_wall(1e4),
}
PASSIVITY = Bilateral(coupling=PassivityConfig())
WAVE = Bilateral(coupling=WaveConfig(play=0.1))
DIRECT = Bilateral(coupling=DirectConfig())
HARD = (0.4, 1.0, 0.006)  # scales of force and motion, [m] of reach: the wall outdoes the arm
SOFT = (0.2, 0.25, 0.024)  # those of a session that nobody has set
LAST = round(0.5 / DT)  # ticks


def cases(*quick):
    """Return what is met after which round trip, all but some of it slow."""
    every = [(met, late) for met in MET for late in ROUND_TRIPS]
    marks = {case: [] if case in quick else pytest.mark.slow for case in every}
    return pytest.mark.parametrize(
        ("met", "round_trip"), [pytest.param(*case, marks=marks[case]) for case in every]
    )


def reach(bilateral, environment, round_trip, gain=HARD, rest=2.0, back=np.inf):
    """Reach, over a network with 50 ms of jitter and 10 % loss, and rest or come back."""
    force_scale, position_scale, target = gain
    begin = 0.6 + round_trip
    network = Network(round_trip, min(0.05, round_trip), 0.1, seed=1)
    return run_hand(
        Teleoperator(
            bilateral, Rig(environment), network, build_settings(force_scale, position_scale)
        ),
        Arm(reaching(target, begin, back=begin + back)),
        begin + 0.6 + rest + (0.0 if np.isinf(back) else back),
        engage=SETTLED + round_trip,
    )


def assert_engaged(record):
    assert record.engaged[-1]


def span(values):
    return np.ptp(values[-LAST:])


def gained(record, bilateral, gain=HARD):
    """Return the energy [J], in tip units, that the hand got out of the whole system at most.

    Less what a hand is known to dissipate by itself.
    """
    damping = getattr(bilateral.coupling, "hand_damping", 0.0)
    return (record.work - damping * record.dragged).max() * gain[1] / gain[0]


@cases(("wall", 0.300))
def test_over_any_network_passivity_is_passive_and_settles(met, round_trip):
    record = reach(PASSIVITY, MET[met], round_trip)
    assert_engaged(record)
    assert record.credit.min() >= -1e-9
    assert gained(record, PASSIVITY) <= 2.0 * PASSIVITY.coupling.reserve
    assert span(record.hand) < 0.1e-3
    assert span(record.force) < 0.25


@cases(("wall", 0.300))
def test_over_any_network_waves_are_passive_and_settle(met, round_trip):
    record = reach(WAVE, MET[met], round_trip, SOFT, rest=2.5)
    assert_engaged(record)
    assert record.credit.min() >= -1e-9
    assert gained(record, WAVE, SOFT) <= 2.0 * WAVE.coupling.reserve
    assert span(record.hand) < 1e-3
    assert span(record.force) < 0.3


@pytest.mark.parametrize(
    "round_trip", [0.100, *(pytest.param(late, marks=pytest.mark.slow) for late in (0.020, 0.300))]
)
def test_direct_is_not(round_trip):
    record = reach(DIRECT, MET["wall"], round_trip)
    assert_engaged(record)
    assert span(record.hand) > 3e-3
    assert span(record.force) > 1.0
    assert gained(record, DIRECT) > 0.05


def test_without_delay_and_prediction_passivity_feels_as_direct_does():
    plainly = Bilateral(coupling=PassivityConfig(stiffness_max=0.0))
    felt, plain = (reach(b, MET["wall"], 0.0, SOFT, rest=1.0, back=1.0) for b in (plainly, DIRECT))
    assert np.abs(felt.force - plain.force).max() < 0.1
    assert np.sqrt(np.mean((felt.force - plain.force) ** 2)) < 0.01
    assert np.abs(felt.followed - plain.followed)[felt.engaged].max() < 0.1e-3


def test_a_hand_with_a_coarse_encoder_rests_on_a_hard_wall_without_a_buzz():
    """A finger feels a tenth of the half newton that a bound by single encoder steps made."""
    round_trip = 0.100
    device = Device(mass=0.1, damping=0.5, resolution=10e-6, smoothing=0.010)
    network = Network(round_trip, min(0.05, round_trip), seed=1)
    system = Teleoperator(
        PASSIVITY, Rig(MET["hard wall"]), network, build_settings(*HARD[:2], network)
    )
    record = zwidth.push_wall(system, HandModel(0.15, 100.0, 3.0), device, 0.0015, round_trip)
    assert_engaged(record)
    assert zwidth.compute_buzz(record) < 0.08
    assert record.force[-LAST:].max() < -0.5


def test_a_tip_that_fell_behind_comes_after_once_it_is_free():
    record = reach(PASSIVITY, MET["hard wall"], 0.300, back=1.0)
    assert_engaged(record)
    assert record.credit.min() >= -1e-9
    behind = record.commanded - record.followed
    assert np.nanmax(behind) > 1e-3
    assert np.abs(behind[-LAST:]).max() < 0.1e-3


@pytest.mark.slow
def test_a_wall_met_again_and_again_is_felt_each_time():
    def prods(time):
        return 0.006 * max(math.sin(2.0 * math.pi * (time - 1.0)), 0.0) if time > 1.0 else 0.0

    network = Network(0.100, 0.05, 0.1)
    system = Teleoperator(PASSIVITY, Rig(MET["wall"]), network, build_settings(*HARD[:2]))
    record = run_hand(system, Arm(prods), 8.0, engage=SETTLED + 0.1)
    assert_engaged(record)
    peaks = [record.force[(record.time > k) & (record.time < k + 1)].min() for k in range(2, 8)]
    assert max(peaks) < -0.5
    assert gained(record, PASSIVITY) <= 2.0 * PASSIVITY.coupling.reserve


def test_sides_that_couple_otherwise_do_not_engage():
    system = Teleoperator(PASSIVITY, Rig(press_nothing), slave_bilateral=WAVE)
    run_hand(system, Arm(reaching(0.0, 0.0)), 0.8)
    for side in (system.master, system.slave):
        assert state_machine.to_outline(side.session) == (State.READY, Reason.COUPLING_DIFFERS)
