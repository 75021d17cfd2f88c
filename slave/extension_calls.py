"""The extensions of a slave in its tick: estimator, coupling and tendon controller.

What they return is checked here, and goes through the same compiled tick and gate as what is built
in. A tick that is computed again after a stall takes what they have returned in it.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from estimator.array_types import Array
from estimator.structs import StructArray
from slave import loop
from slave.config import SlaveConfig
from slave.extensions import ControlInput, HousingSample, TipEstimate
from slave.loop import RigModel, SlaveRecords
from slave.loop_records import EstimatedSample, TickInput
from slave.rig import RigSample
from teleop.config.extension_calls import CheckedExtension
from teleop.config.ranges import MOTION_MAX
from teleop.coupling import CouplingConfig
from teleop.coupling.extension import SIGNAL_MAX, CouplingExtension, TipMotion, TipPort
from teleop.messages.messages import MAX_TENDONS, Command, SlaveState
from teleop.messages.packet import Packet
from teleop.runtime.compiling import announce_compilation
from teleop.session.state_machine import State

TIP_TENSION_RATIO = 10.0  # largest tension at a tip over the limit at the housing: e^K and more
_ENGAGED = int(State.ENGAGED)

COMPILE_S = 10.0  # [s] of a processor, without a cache


def _compile_parts(slave: SlaveRecords) -> None:
    """Compile the parts of a tick, which are else called in one."""
    settings, layout, memory, scratch = slave.tick_arguments
    records = settings, layout, memory.copy(), scratch.copy()
    tick_input, command = TickInput(1e-3, True, False), Packet(Command).records
    loop.compute_port_forces(*records, command)
    engaged = loop.begin_tick(*records, EstimatedSample.array(), 0, tick_input, command)
    loop.end_tick(*records, tick_input, command, Packet(SlaveState).records, engaged)


class SlaveExtensions:
    """The extensions that a config names, those `opened`; `UsageError` if one cannot be.

    `estimates`, shape (samples, 4, MAX_TENDONS), are those of the own estimator, if there is one,
    for `slave.samples.estimate`.
    """

    def __init__(
        self, config: SlaveConfig, coupling: CouplingConfig, model: RigModel, slave: SlaveRecords
    ) -> None:
        self._gate, self._records = config.gate, slave
        self._joints, self._tendons = len(model.joints), len(model.models)
        self._travel_max = config.gate.displacement_max - config.gate.displacement_min
        self._estimator = self._controller = self._coupling = None
        self.estimates: Array | None = None
        self._newest = np.full((4, MAX_TENDONS), np.nan)
        if estimator := config.estimator:
            self._estimator = CheckedExtension(
                "slave.estimator", estimator, lambda: estimator.open(model.models), "step"
            )
            self.estimates = self._newest[np.newaxis]
        if controller := config.controller:
            self._controller = CheckedExtension(
                "slave.controller", controller, lambda: controller.open(model.joints), "step"
            )
        if isinstance(coupling, CouplingExtension):
            self._coupling = CheckedExtension(
                "coupling", coupling, lambda: coupling.open_slave(self._joints), "move"
            )
        found = self._estimator, self._controller, self._coupling
        self.opened = [extension for extension in found if extension]
        if self.opened:
            with announce_compilation("the slave's extensions", COMPILE_S):
                _compile_parts(slave)
        self._time_s: float | None = None  # of the newest sample that was estimated
        self._was_moving = self._was_following = False  # motors, tips at the last tick
        self._results: dict[str, Any] = {}  # of this tick

    def start_tick(self) -> None:
        """Let each be called once more."""
        self._results.clear()

    def estimate(self, samples: Sequence[RigSample]) -> None:
        """Write the own estimates of new samples; `ExtensionFault`."""
        if self._estimator is None or not samples:
            return
        rows = np.empty((len(samples), 4, MAX_TENDONS))
        for row, sample in zip(rows, samples, strict=True):
            tension, travel = sample.proximal_tension, sample.proximal_displacement
            if np.isfinite(tension).all() and (travel is None or np.isfinite(travel).all()):
                self._newest[:, : self._tendons] = self._estimate_sample(self._estimator, sample)
            row[:] = self._newest  # of an incomplete sample: as before
        self.estimates = rows

    def _estimate_sample(
        self, estimator: CheckedExtension, sample: RigSample
    ) -> tuple[Any, Any, Any, Any]:
        dt = 0.0 if self._time_s is None else sample.time_s - self._time_s
        self._time_s = sample.time_s
        travel = sample.proximal_displacement
        measured = HousingSample(
            dt, sample.proximal_tension.copy(), None if travel is None else travel.copy()
        )
        returned = estimator.check_tuple("step", estimator.call("step", measured), TipEstimate)
        limits = *((TIP_TENSION_RATIO * self._gate.tension_max, "N"),) * 3, (self._travel_max, "m")
        named = zip(TipEstimate._fields, returned, limits, strict=True)
        tension, low, high, elongation = (
            estimator.check("step", name, values, self._tendons, *limit)
            for name, values, limit in named
        )
        if not ((low <= tension) & (tension <= high)).all():
            ends = f"low {low.tolist()} and high {high.tolist()} [N]"
            text = f"tension {tension.tolist()} is not between {ends}"
            raise estimator.build_fault("step", text)
        return tension, low, high, elongation

    def run_tick(
        self,
        rows: StructArray,
        samples: int,
        tick_input: TickInput,
        commands: StructArray,
        states: StructArray,
    ) -> int:
        """Run `slave.loop.run_tick` with the own coupling and controller; `ExtensionFault`."""
        records = self._records.tick_arguments
        _, _, memories, scratches = records
        n, sent = self._joints, None
        coupling, controller = self._coupling, self._controller
        if coupling is not None:
            following = self._may_follow(tick_input, memories, commands)
            if following:
                loop.compute_port_forces(*records, commands)
                motion = self._compute_once(
                    "move", lambda: self._move_tips(coupling, tick_input.dt, commands)
                )
                side = memories["coupling"]
                side["own_position"][0, :n], side["own_velocity"][0, :n], sent = motion
            self._was_following = following
        engaged = loop.begin_tick(*records, rows, samples, tick_input, commands)
        if controller is not None:
            moving = engaged and tick_input.motors_follow
            target = scratches["motor_position"][0, : self._tendons]
            if moving:
                target = self._compute_once(
                    "step", lambda: self._control(controller, tick_input.dt)
                )
            self._was_moving = moving
            scratches["extension_target"][0, : self._tendons] = target
            scratches["has_extension_target"] = True
        verdict = loop.end_tick(*records, tick_input, commands, states, engaged)
        if sent is not None:
            states["wave"][0, :n] = sent
        return verdict

    def _compute_once(self, name: str, compute: Callable[[], Any]) -> Any:
        """Return the result of this tick."""
        if name not in self._results:
            self._results[name] = compute()
        return self._results[name]

    @staticmethod
    def _may_follow(tick_input: TickInput, memories: StructArray, commands: StructArray) -> bool:
        """Return whether the tips, which followed at the last tick, may do so at this one."""
        commanded = tick_input.has_command and tick_input.fresh and not tick_input.fault
        followed = memories["coupling"]["coupled"][0] and commands["state"][0] == _ENGAGED
        return bool(commanded and followed)

    def _move_tips(
        self, coupling: CheckedExtension, dt: float, commands: StructArray
    ) -> tuple[Array, Array, Array]:
        """Return the tips' motion [m], [m/s], and what the master shall be sent."""
        n = self._joints
        copies = [commands[name][0, :n].copy() for name in ("position", "velocity")]
        copies += [self._records.scratch["force"][0, :n].copy(), commands["wave"][0, :n].copy()]
        if not all(np.isfinite(values).all() for values in copies):  # which the tick refuses
            return copies[0], copies[1], np.zeros(n)
        port = TipPort(dt, not self._was_following, *copies)
        returned = coupling.check_tuple("move", coupling.call("move", port), TipMotion)
        limits = (MOTION_MAX, "m"), (MOTION_MAX, "m/s"), (SIGNAL_MAX, "")
        position, velocity, sent = (
            coupling.check("move", name, values, n, *limit)
            for name, values, limit in zip(TipMotion._fields, returned, limits, strict=True)
        )
        lead = float(np.abs(position - copies[0]).max())
        if lead > self._travel_max:
            text = f"position is {lead:g} m from the commanded one, at most {self._travel_max:g} m"
            raise coupling.build_fault("move", text)
        return position, velocity, sent

    def _control(self, controller: CheckedExtension, dt: float) -> Array:
        """Return the motor targets [m]."""
        scratch, memory = self._records.scratch[0], self._records.memory[0]
        n, m = self._joints, self._tendons
        joints, tendons = memory["joints"][:n], memory["tendons"][:m]
        motor = scratch["motor_position"][:m]
        of_joints = (
            scratch["requested"][:n],
            scratch["tip_velocity"][:n],
            joints["position"],
            joints["force"],
        )
        of_tendons = (
            motor,
            tendons["tension"],
            *(tendons["estimate"][name] for name in ("distal_tension", "elongation")),
        )
        copies = (np.array(values) for values in (*of_joints, *of_tendons))
        state = ControlInput(dt, not self._was_moving, *copies)
        returned = controller.call("step", state)
        target = controller.check("step", "target", returned, m, MOTION_MAX, "m")
        jump = float(np.abs(target - motor).max())
        if jump > self._travel_max:
            text = f"target is {jump:g} m from the motor, at most {self._travel_max:g} m"
            raise controller.build_fault("step", text)
        return target
