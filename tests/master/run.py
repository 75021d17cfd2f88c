"""A master driven tick by tick, with a slave that does as it is told."""

from typing import Any, NamedTuple

import numpy as np

from estimator.structs import view_struct
from master import loop
from master.axis_map import VelocityMap
from master.config import MasterConfig
from master.device import HandState
from master.feedback import FeedbackConfig
from master.gate import GateConfig
from master.hand_input import HandInput, fill_hand_input
from master.settings_record import SettingsRecord
from teleop.coupling import Bilateral
from teleop.messages.messages import MAX_JOINTS, Command, SlaveState, pad_values
from teleop.session import state_machine
from teleop.session.state_machine import Reason, State
from tests.master.records import message_records, to_message_records

MS = 1_000_000
EPOCH = 1_700_000_000 * 10**9
CONFIG = MasterConfig(
    force=FeedbackConfig(scale=0.2, slew=1e6), gate=GateConfig(slew_max=1e6, exceed_bounds=True)
)
DIRECT = Bilateral()


def hand(position=0.0, engage=True, velocity=0.0, **buttons):
    return HandState((position,), (velocity,), engage, **buttons)


def answer(now, state=State.ENGAGED, force=5.0, echo=None, sender=7, sample_age=0):
    return SlaveState(
        sender=sender,
        stamp_ns=now,
        state=state,
        joints=1,
        sample_age_ns=sample_age,
        echo_stamp_ns=now - MS if echo is None else echo,
        force=pad_values((force,), MAX_JOINTS),
        force_low=pad_values((force - 1.0,), MAX_JOINTS),
        force_high=pad_values((force + 1.0,), MAX_JOINTS),
    )


class Output(NamedTuple):
    """What a tick asks of the world."""

    command: Command
    force: tuple[float, ...]
    verdict: int
    answer_ns: int


class Run:
    """A master and its records; `memory` is its `MasterMemory`."""

    def __init__(self, config=CONFIG, bilateral=DIRECT, axes=1):
        self.config, self.now, self.axes = config, EPOCH, axes
        self._settings = SettingsRecord(config, bilateral)
        self.memories = loop.init_master(axes, self.now)
        self.memory = view_struct(self.memories)
        self.hands, self._maps = HandInput.array(), VelocityMap.array()
        self.input = loop.TickInput(1e-3, self.now, False, 0)
        self._states = message_records(SlaveState)
        self.output: Any = None

    def tick(
        self,
        the_hand,
        state=None,
        age=0,
        fault=Reason.NONE,
        stop=Reason.NONE,
        reset=False,
        later=None,
        later_age=0,
        wait=0,
        dt=1e-3,
    ):
        """Run both phases; the second one `wait` ns later, with the state `later` if there is."""
        self.now += MS
        fill_hand_input(self.hands, the_hand)
        self.input = loop.TickInput(dt, self.now, False, 0, int(fault), int(stop), reset)
        self._receive(state, age, self.now)
        out, force = message_records(Command), np.zeros(MAX_JOINTS)
        loop.compute_command(*self.inputs, out)
        if later is None:
            self._receive(state, age + wait, self.now + wait)
        else:
            self._receive(later, later_age, self.now + wait)
        verdict = loop.compute_force(*self.inputs, self._maps, later is not None, force)
        assert not force[self.axes :].any()
        self.output = Output(
            Command(**{n: self._value(out[n][0]) for n in out.dtype.names}),
            tuple(force[: self.axes].tolist()),
            verdict,
            int(self.memory.newly_answered_ns),
        )
        return self.output

    def answered(self, the_hand, state=State.ENGAGED, force=5.0, age=0, **more):
        return self.tick(the_hand, answer(self.now + MS, state, force, **more), age)

    def engaged(self):
        for _ in range(3):
            self.answered(hand(engage=False), State.READY)
        self.answered(hand(), State.READY)
        self.answered(hand())
        assert state_machine.may_render(self.memory.session)
        return self

    @property
    def inputs(self):
        settings = self._settings.update(self.config)
        return settings, self.memories, self.hands, self.hands, self._states, self.input

    @property
    def session(self):
        return state_machine.to_outline(self.memory.session)

    @property
    def state(self):
        return self.session.state

    def _receive(self, state, age, now):
        self.input = self.input._replace(has_state=state is not None, state_age_ns=age, now_ns=now)
        if state is not None:
            self._states = to_message_records(state)

    @staticmethod
    def _value(value):
        return tuple(value.tolist()) if value.ndim else value.item()
