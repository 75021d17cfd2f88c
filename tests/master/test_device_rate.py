"""A device that is read more often than the slave answers: what is rendered in between."""

import functools
from typing import NamedTuple

import numpy as np
import pytest

from estimator.structs import view_struct
from master import hand_input, loop
from master.axis_map import VelocityMap
from master.config import MasterConfig
from master.device import HandState
from master.devices.virtual import Reaches, VirtualConfig, advance_hand
from master.feedback import FeedbackConfig
from master.gate import GateConfig
from master.operator import OperatorConfig
from master.settings_record import SettingsRecord
from teleop import coupling
from teleop.coupling import (
    Bilateral,
    DirectConfig,
    PassivityConfig,
    Side,
    WaveConfig,
    to_bilateral_settings,
)
from teleop.messages.messages import MAX_JOINTS, Command, SlaveState
from teleop.session.state_machine import State
from tests.master.records import message_records

EPOCH = 1_700_000_000 * 10**9
WALL = 2000.0  # [N/m]
WALL_AT = 0.002  # [m] of the tip
SCALE = 0.4  # of force; motion is one to one: the wall outdoes the arm
PRESSED = 0.006  # [m] where the arm pulls the hand to
ENGAGED_S, END_S = 0.05, 2.0
LAST_S = 0.5
ARM = VirtualConfig(reference=Reaches(targets=(PRESSED,), reach=0.6))
COUPLINGS = {"passivity": PassivityConfig(), "wave": WaveConfig()}
RATES = {  # of the link [Hz], ticks of the device for one command
    "1 kHz": (1000.0, 1),
    "4 kHz on 1 kHz": (1000.0, 4),
    "4 kHz on 100 Hz": (100.0, 40),
    "100 Hz": (100.0, 1),
}
SLOW = pytest.mark.slow
QUICK = (
    *(("passivity", "4 kHz on 100 Hz", 0.040), ("passivity", "1 kHz", 0.0)),
    *(("wave", "4 kHz on 1 kHz", 0.040), ("wave", "100 Hz", 0.040)),
)
CASES = [  # coupling, rates, delay of the link each way [s]
    pytest.param(*(name, rate, late_s), marks=[] if (name, rate, late_s) in QUICK else SLOW)
    for name in COUPLINGS
    for rate in RATES
    for late_s in (0.0, 0.010, 0.040)
]


class Trace(NamedTuple):
    """What happened, one row for each tick of the device."""

    time: np.ndarray  # [s]
    hand: np.ndarray  # [m]
    force: np.ndarray  # [N] on the hand
    told: np.ndarray  # [N] what the newest answer says of the tip
    credit: np.ndarray  # [J] the smaller of both ports
    surplus: np.ndarray  # [J] put in and granted, less taken out, of both ports
    gained: np.ndarray  # [J] in tip units that the hand has got out of the device


class Wall:
    """A slave whose tip is where the coupling sends it at once, in front of a spring."""

    def __init__(self, bilateral):
        self.settings = view_struct(to_bilateral_settings(bilateral))
        self.side, self.tip, self.coupled = Side.new(), 0.0, False
        self.echo_ns, self.state = 0, State.READY

    @property
    def force(self):
        return WALL * max(self.tip - WALL_AT, 0.0)

    def answer(self, command, now_ns, dt):
        self.state = State.ENGAGED if command["state"] == State.ENGAGED else State.READY
        coupling.receive_totals(self.side, np.uint64(8), command["energy"], command["wave"])
        asked, speed = command["position"].copy(), command["velocity"].copy()
        force = np.zeros(MAX_JOINTS)
        force[0] = self.force
        engaged = self.state == State.ENGAGED
        coupling.compute_tip_motion(self.settings, self.side, asked, speed, force, 1, engaged, dt)
        if engaged:
            self.tip = float(asked[0])
        ports = self.side.ports
        force[0] = self.force
        return {
            "sender": 7,
            "stamp_ns": now_ns,
            "state": self.state,
            "joints": 1,
            "echo_stamp_ns": command["stamp_ns"],
            "position": [self.tip] + [0.0] * 7,
            "force": force,
            "force_low": force - 0.01,
            "force_high": force + 0.01,
            "energy": [port.passed_on for port in ports],
            "wave": [port.sent_wave for port in ports],
            "coupling": self.settings.signature,
        }


@functools.cache
def pressed(config, rate, late_s=0.0):
    """Press a hand against the wall through a master's two phases and a slave.

    `late_s` is how long a message takes, each way.
    """
    rate_hz, every = RATES[rate]
    late = round(late_s * rate_hz * every)  # [ticks of the device]
    bilateral = Bilateral(coupling=config)
    master = MasterConfig(
        force=FeedbackConfig(scale=SCALE),
        gate=GateConfig(),
        operator=OperatorConfig(position_scale=1.0),
        state_timeout=0.2,
        delay_max=0.5,
    )
    settings = SettingsRecord(master, bilateral).records
    memories, hands = loop.init_master(1, EPOCH), hand_input.HandInput.array()
    memory, slave = view_struct(memories), Wall(bilateral)
    states, commands = message_records(SlaveState), message_records(Command)
    maps = VelocityMap.array()
    dt = 1.0 / (rate_hz * every)
    force, x, v = np.zeros(MAX_JOINTS), 0.0, 0.0
    there, back, rows, gained = [], [], [], 0.0
    has_state, received = False, EPOCH
    for k in range(round(END_S / dt)):
        now = EPOCH + round(k * dt * 1e9)
        time_s = k * dt
        before = x
        steps = max(round(dt / 1e-3), 1)  # of the hand's own motion
        for _ in range(steps):
            x, v = advance_hand(ARM, x, v, time_s, float(force[0]), dt / steps)
        gained += float(force[0]) * (x - before)
        engage = time_s >= ENGAGED_S
        hand_input.fill_hand_input(hands, HandState((x,), (v,), engage))
        given = loop.TickInput(dt, now, has_state, now - received)
        loop.compute_command(settings, memories, hands, hands, states, given, commands)
        if k % every == 0:
            commands["stamp_ns"] = now
            there.append((k + late, commands[0].copy()))
        while there and there[0][0] <= k:
            back.append((k + late, slave.answer(there.pop(0)[1], now, 1.0 / rate_hz)))
        is_new = False
        while back and back[0][0] <= k:
            for name, value in back.pop(0)[1].items():
                states[name] = value
            is_new = has_state = True
            received = now
        given = loop.TickInput(dt, now, has_state, now - received)
        loop.compute_force(settings, memories, hands, hands, states, given, maps, is_new, force)
        near, far = memory.coupling.ports[0], slave.side.ports[0]
        put_in = near.put_in + far.put_in + near.granted + far.granted
        rows.append(
            (
                time_s,
                x,
                float(force[0]),
                float(states["force"][0][0]),
                min(near.credit, far.credit),
                put_in - near.taken_out - far.taken_out,
                gained / SCALE,
            )
        )
    assert memory.session.state == State.ENGAGED
    return Trace(*np.array(rows).T)


def span(values, trace, until=END_S):
    """Return how far values swing in the last `LAST_S` before `until`."""
    return np.ptp(values[(trace.time > until - LAST_S) & (trace.time <= until)])


@pytest.mark.parametrize(("name", "rate", "late_s"), CASES)
def test_at_no_rate_more_comes_out_of_both_ports_than_went_in_and_a_wall_is_stable(
    name, rate, late_s
):
    config = COUPLINGS[name]
    trace = pressed(config, rate, late_s)
    assert trace.told.max() > 0.5  # the wall was met
    assert trace.credit.min() >= -1e-12
    assert trace.surplus.min() >= -1e-12
    assert trace.gained.max() <= 2.0 * config.reserve
    assert span(trace.hand, trace) < 0.2e-3
    before = span(trace.hand, trace, END_S - LAST_S)
    assert span(trace.hand, trace) <= before + 0.02e-3


@pytest.mark.parametrize("rate", ["1 kHz", pytest.param("4 kHz on 100 Hz", marks=SLOW)])
def test_direct_gives_energy_at_every_rate(rate):
    """So that the property above can fail."""
    trace = pressed(DirectConfig(), rate, 0.010)
    assert trace.surplus.min() < -0.05
    assert trace.gained.max() > 0.05


def test_the_hand_feels_the_same_wall_at_every_rate():
    rates = ("1 kHz", "4 kHz on 100 Hz", "100 Hz")
    rests = [pressed(COUPLINGS["passivity"], rate).force[-1] for rate in rates]
    assert rests == pytest.approx([rests[0]] * len(rests), rel=0.02)
