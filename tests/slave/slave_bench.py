"""A slave driven tick by tick: samples and commands in, its answer and motor positions out."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.structs import StructArray, view_struct
from slave import loop
from slave.config import SlaveConfig
from slave.gate import GateFlags
from slave.loop import RigModel
from slave.loop_records import SlaveMemory, TickInput
from slave.rig import RigSample
from slave.samples import estimate, to_sample_rows
from teleop.coupling import Bilateral
from teleop.messages.messages import Command, SlaveState
from teleop.messages.packet import Packet
from teleop.session import state_machine
from teleop.session.state_machine import Reason, SessionOutline, State

DT = 0.001  # [s]


class Output(NamedTuple):
    """What a tick asks of the world."""

    motor: tuple[float, ...]  # [m] to be written to the rig; empty = nothing yet
    verdict: GateFlags
    state: SlaveState  # the answer, without a head
    rows: StructArray  # `EstimatedSample` of the samples


class SlaveBench:
    """A slave and its records, without clock, link and rig.

    Attributes
    ----------
    slave : Slave
    memory : SlaveMemory
        What it remembers, as it is now.
    """

    def __init__(
        self,
        model: RigModel,
        config: SlaveConfig,
        starts_at_zero: bool = False,
        samples: Sequence[RigSample] = (),
        bilateral: Bilateral = loop.DIRECT,
    ) -> None:
        self.slave = loop.init_slave(model, config, bilateral, starts_at_zero, samples)
        self.memory: SlaveMemory = view_struct(self.slave.memory)
        self._tendons = len(model.models)
        self._command, self._state = Packet(Command), Packet(SlaveState)
        self._state.data[4:] = b"\xff" * (len(self._state.data) - 4)  # a tick writes all of it

    def tick(
        self,
        samples: Sequence[RigSample] = (),
        command: Command | None = None,
        fresh: bool = True,
        fault: Reason = Reason.NONE,
        dt: float = DT,
        stop: Reason = Reason.NONE,
        reset: bool = False,
        motors_follow: bool = True,
    ) -> Output:
        """Go on by a tick, in which `command` is the newest that has come."""
        if command is not None:
            self._command.fill(command)
        given = TickInput(
            dt,
            command is not None,
            fresh,
            int(fault),
            int(stop),
            reset,
            motors_follow=motors_follow,
        )
        return self.step(samples, self._command.records, given)

    def step(self, samples: Sequence[RigSample], commands: StructArray, given: TickInput) -> Output:
        """Go on by a tick, with the newest command as a record."""
        slave, rows, count = self.slave, to_sample_rows(samples), len(samples)
        estimate(*slave.estimate_arguments, rows, count)
        verdict = loop.run_tick(
            *slave.tick_arguments, rows, count, given, commands, self._state.records
        )
        loop.monitor_calibration(*slave.monitor_arguments, rows, count)
        state = SlaveState.unpack(self._state.seal(0, 0, 0))
        return Output(self.motor, GateFlags(verdict), state, rows)

    @property
    def motor(self) -> tuple[float, ...]:
        """Where the gate let the motors go last [m]; empty = they were never sent anywhere."""
        motor: np.ndarray = self.slave.memory["gated_position"][0, : self._tendons]
        return tuple(motor.tolist()) if self.memory.has_gated_position else ()

    @property
    def session(self) -> SessionOutline:
        """State and reason of the session."""
        return state_machine.to_outline(self.memory.session)

    @property
    def state(self) -> State:
        """State of the session."""
        return self.session.state
