"""The study: what is measured, for each coupling and delay, as tasks that can run side by side."""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

from studies.transparency import hybrid, stiffness, zwidth
from studies.transparency.hand import Device, HandModel
from studies.transparency.hybrid import Excitation, Hybrid
from studies.transparency.rig import Environment, Rig, build_wall, press_nothing
from studies.transparency.stiffness import SpringContact
from studies.transparency.system import Network, Teleoperator, build_rig_model, build_settings
from studies.transparency.zwidth import Width
from teleop.coupling import Bilateral, CouplingConfig, DirectConfig, PassivityConfig, WaveConfig

COUPLINGS = ("direct", "passivity", "wave")
LINEAR = ("direct",)  # those whose law is: force and motion pass as they are
CONTACT = 0.0015  # [m] of the tip at which the wall of the Z-width begins
LOAD = 3.0  # [N] around which the tip is loaded for the hybrid parameters
FRICTION = 1e-3  # K that the estimator is told; the rig has none
PRETENSION, SPRING = 1.0, 200.0  # [N], [N/m] of the load besides

HANDS = {"relaxed": HandModel(0.15, 100.0, 3.0), "firm": HandModel(0.3, 600.0, 12.0)}
DEVICE = Device(mass=0.1, damping=0.5, resolution=10e-6, smoothing=0.010)
EXCITATION = Excitation()


@dataclass(frozen=True, slots=True)
class Study:
    """All that was set."""

    couplings: tuple[str, ...] = COUPLINGS
    round_trips: tuple[float, ...] = (0.0, 0.020, 0.100, 0.200, 0.300)  # [s]
    jitter: float = 0.0  # [s] of the round trip, and never more than that
    loss: float = 0.0  # share of the messages, each way
    force_scale: float = 0.4  # force on the hand per force at the tip
    position_scale: float = 1.0  # tip travel per hand travel
    device: Device = DEVICE
    dampings: tuple[float, ...] = (0.5, 5.0)  # [N s/m] of the device, for the Z-width
    stiffnesses: tuple[float, ...] = (100.0, 300.0, 1000.0, 3000.0, 10000.0)  # [N/m] pressed
    lowest: float = 100.0  # [N/m] of the walls
    cap: float = 10000.0  # [N/m]
    factor: float = 10.0  # by which their stiffness rises at first
    within: float = 1.2  # ratio to which the Z-width is reported
    excitation: Excitation = EXCITATION

    def build_network(self, round_trip: float) -> Network:
        """Return the network of so long a round trip [s]."""
        return Network(round_trip, min(self.jitter, round_trip), self.loss, seed=1)

    def build_coupling(self, name: str) -> CouplingConfig:
        """Return a coupling: as a session has it that sets nothing, but for this jitter."""
        if name == "wave":
            wave = WaveConfig()
            return replace(wave, play=max(wave.play, 2.0 * self.jitter))
        return PassivityConfig() if name == "passivity" else DirectConfig()

    def is_linear(self, name: str, round_trip: float) -> bool:
        """Return whether Llewellyn's criterion applies: a linear law, a constant network."""
        return name in LINEAR and self.build_network(round_trip).constant

    def build_system(
        self, name: str, round_trip: float, environment: Environment, spring: float, load: float
    ) -> Teleoperator:
        """Return a new session."""
        network = self.build_network(round_trip)
        return Teleoperator(
            Bilateral(coupling=self.build_coupling(name)),
            Rig(environment, spring, load),
            network,
            build_settings(self.force_scale, self.position_scale, network),
            build_rig_model(FRICTION),
        )


def shorten_study(study: Study) -> Study:
    """Return the study with the least that still says something."""
    return replace(
        study,
        dampings=study.dampings[:1],
        stiffnesses=(300.0, 3000.0),
        within=study.factor,
        excitation=Excitation(
            period=1.0, harmonics=(1, 3, 7, 15, 31, 49), settle=0.7, periods=2, draws=1
        ),
    )


class Task(NamedTuple):
    """One thing to measure."""

    kind: str  # of KINDS
    coupling: str
    round_trip: float  # [s]
    hand: str = ""  # of HANDS
    damping: float = 0.0  # [N s/m] of the device


class Walls(NamedTuple):
    """What a hand can be shown of walls."""

    width: Width
    buzz: float  # [N] of the force at rest, at the largest stiffness that was stable; NaN: at none


class Case(NamedTuple):
    """What was measured of a coupling at a delay."""

    coupling: str
    round_trip: float  # [s]
    pressed: tuple[SpringContact, ...]
    walls: dict[tuple[str, float], Walls]  # by hand and damping
    hybrid: Hybrid


def list_tasks(study: Study) -> list[Task]:
    """Return all that is to be measured, what takes long first."""
    cells = [(name, delay) for name in study.couplings for delay in study.round_trips]
    return [
        *(Task("zwidth", *cell, h, b) for cell in cells for h in HANDS for b in study.dampings),
        *(Task("hybrid", *cell) for cell in cells),
        *(Task("stiffness", *cell) for cell in cells),
    ]


def measure_task(study: Study, task: Task) -> Any:
    """Return what a task's measurement gives."""
    return KINDS[task.kind](study, task)


def gather_cases(study: Study, done: dict[Task, Any]) -> list[Case]:
    """Return what was measured, by coupling and delay."""
    return [
        Case(
            name,
            delay,
            done[Task("stiffness", name, delay)],
            {
                (hand, damping): done[Task("zwidth", name, delay, hand, damping)]
                for hand in HANDS
                for damping in study.dampings
            },
            done[Task("hybrid", name, delay)],
        )
        for name in study.couplings
        for delay in study.round_trips
    ]


def _measure_stiffness(study: Study, task: Task) -> tuple[SpringContact, ...]:
    scales = study.force_scale, study.position_scale
    return tuple(
        stiffness.press_spring(
            study.build_system(task.coupling, task.round_trip, build_wall(k, 0.0), 0.0, PRETENSION),
            k,
            scales,
            task.round_trip,
            study.device,
        )
        for k in study.stiffnesses
    )


def _measure_zwidth(study: Study, task: Task) -> Walls:
    device = replace(study.device, damping=task.damping)
    buzz = {}

    def stable(k: float) -> bool:
        met = build_wall(k, CONTACT)
        record = zwidth.push_wall(
            study.build_system(task.coupling, task.round_trip, met, SPRING, PRETENSION),
            HANDS[task.hand],
            device,
            CONTACT / study.position_scale,
            task.round_trip,
        )
        buzz[k] = zwidth.compute_buzz(record)
        return zwidth.has_settled(record)

    width = zwidth.find_largest_width(stable, study.lowest, study.cap, study.factor, study.within)
    return Walls(width, buzz.get(width.stable, math.nan))


def _measure_hybrid(study: Study, task: Task) -> Hybrid:
    return hybrid.measure_hybrid(
        partial(study.system, task.coupling, task.round_trip, press_nothing, 0.0, LOAD),
        study.excitation,
        study.device,
        study.position_scale,
        task.round_trip,
    )


KINDS = {"stiffness": _measure_stiffness, "zwidth": _measure_zwidth, "hybrid": _measure_hybrid}
