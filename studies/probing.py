"""Accuracy of K from probing at rest, motion of the tip meanwhile, and cost of uneven changes.

python -m studies.probing              20 pairs, then 20 single tendons against a spring
python -m studies.probing --uneven     the change is in the first, second or last third only

A joint presses into tissue within 1.2 s and rests, with no other motion; the slave's whole loop
then probes the loaded tendon for 10 s. The model has K 0.5 to 1.5, evenly bent; all friction has
changed by -30 to +40 % since. EA and L are right. The plant is the simulated rig, which shares no
equation with the estimator. Settings were tried on seed 0 only; 20 sheaths take 5 minutes.
"""

from math import cos, exp, pi
from typing import Any, NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.online.online import TendonModel
from estimator.structs import view_struct
from slave import loop
from slave.calibration import probing
from slave.calibration.monitor import MonitorConfig
from slave.calibration.probing import ProbingConfig
from slave.config import SlaveConfig
from slave.gate import GateConfig
from slave.loop_records import TickInput
from slave.rigs.simulated import JointConfig, SimulatedRig, SimulatedRigConfig
from slave.samples import estimate, to_sample_rows
from slave.sheath_section import SectionConfig
from slave.simulation.environment import TissueConfig
from studies.testbed.command import parse_options
from studies.testbed.control_bench import MU, build_joint, build_model
from teleop.messages.messages import Command, SlaveState, pad_values
from teleop.messages.packet import Packet
from teleop.session.state_machine import State

DT, ENGAGED_S, PRESSED_S, PROBED_S = 1e-3, 0.1, 1.3, 10.0  # [s]
CONTACT = 0.002  # [m]
SETTINGS: dict[str, Any] = {
    "calibration": "as-built",
    "gate": GateConfig(displacement_min=-0.05),
    "probing": ProbingConfig(enabled=True),
    "monitor": MonitorConfig(on_demand="degrade"),  # a wrong K does not end the session
}


class RandomJoint(NamedTuple):
    """A random sheath, and its model."""

    plant: JointConfig
    models: list[TendonModel]
    K: float  # true
    K_model: float
    depth: float  # [m] of the press


class Rest(NamedTuple):
    """What probing found while a hand rested, a row a tick from the end of the press on."""

    K: Array  # of each probe
    tip: Array  # [m] true travel of the joint
    probed: Array  # number of the probed tendon, 0 = none
    state: Array  # State of the session
    error: float  # of T_out, by the monitor of the loaded tendon


def compute_press(time: float, depth: float) -> float:
    """Return the commanded travel [m] of a hand that presses to `depth` beyond contact."""
    share = min(max((time - ENGAGED_S) / (PRESSED_S - ENGAGED_S), 0.0), 1.0)
    return (CONTACT + depth) * 0.5 * (1.0 - cos(pi * share))


def run_rest(drawn: RandomJoint, seed: int = 1, seconds: float = PROBED_S) -> Rest:
    """Let the slave press a joint into tissue and probe while it rests."""
    config = SlaveConfig(SimulatedRigConfig(joints=(drawn.plant,), seed=seed), **SETTINGS)
    rig = SimulatedRig(config.rig)
    rig_model = loop.build_rig_model(rig.joints, drawn.models)
    slave = loop.init_slave(rig_model, config, loop.DIRECT, True)
    memory, command, state = view_struct(slave.memory), Packet(Command), Packet(SlaveState)
    known = view_struct(slave.settings["probed"][0, :1])
    rows, K = [], []
    for k in range(round((PRESSED_S + seconds) / DT)):
        time, samples = k * DT, rig.read(k * DT)
        now, ahead = compute_press(time, drawn.depth), compute_press(time + DT, drawn.depth)
        engaged = State.ENGAGED if time > ENGAGED_S else State.READY
        position, velocity = pad_values((now,), 8), pad_values(((ahead - now) / DT,), 8)
        command.fill(Command(state=engaged, position=position, velocity=velocity))
        sampled = to_sample_rows(samples)
        estimate(*slave.estimate_arguments, sampled, len(samples))
        given, records = TickInput(DT, True, True), (command.records, state.records)
        loop.run_tick(*slave.tick_arguments, sampled, len(samples), given, *records)
        if memory.probe.finished >= 0:
            K.append(probing.estimate_friction(known, probing.compute_share(memory.probe))[0])
        loop.monitor_calibration(*slave.monitor_arguments, sampled, 1)
        if memory.has_gated_position:
            rig.write(memory.gated_position[: rig.tendons].copy())
        if time >= PRESSED_S:
            rows.append((rig.joint_travel[0], *(state.records[n][0] for n in ("probing", "state"))))
    tip, probed, states = map(np.array, zip(*rows, strict=True))
    K = np.array(K)[np.isfinite(K)]
    return Rest(K, tip, probed, states, float(memory.monitors[0].force_error))


def draw_joint(rng: np.random.Generator, tendons: int, third: int | None = None) -> RandomJoint:
    """Return a random joint; friction is wrong all along, or in one third of K."""
    K_model, factor = rng.uniform(0.5, 1.5), rng.uniform(0.7, 1.4)
    depth, tension = rng.uniform(0.002, 0.004), rng.uniform(5.0, 15.0)
    factors = [factor if third in (None, k) else 1.0 for k in range(3)]
    sections = tuple(SectionConfig(0.5, 3.0 * MU * 0.5 / (K_model * f)) for f in factors)
    K = K_model * float(np.mean(factors))
    tissue = TissueConfig(position=CONTACT, stiffness=tension * exp(-K) / depth**1.5)
    noise, slack = rng.uniform(0.005, 0.02), {1: 2.0, 2: 0.5}[tendons]
    plant = build_joint(
        K, 300.0 if tendons == 1 else 0.0, tissue, tendons, noise, pretension=slack,
        sections=sections, nodes=40,
    )  # fmt: skip
    wrong = build_model(plant.tendons[0], slack, K_model / K, 1.0)
    return RandomJoint(plant, [wrong] * tendons, K, K_model, depth)


def main() -> None:
    """Print the figures."""
    options = parse_options(
        __doc__,
        sheaths=(20, "number of them, of each kind"),
        first=(100, "first seed"),
        uneven=(False, "friction changes in one third only"),
    )
    results: dict[int, list[tuple[float, float, int]]] = {2: [], 1: []}
    for seed in range(options.first, options.first + options.sheaths):
        for tendons, rows in results.items():
            rng = np.random.default_rng(seed)
            drawn = draw_joint(rng, tendons, seed % 3 if options.uneven else None)
            found = run_rest(drawn, seed)
            error = np.median(found.K) / drawn.K - 1.0 if len(found.K) else np.nan
            probes = np.split(np.arange(len(found.tip)), np.flatnonzero(np.diff(found.probed)) + 1)
            during = [np.ptp(found.tip[ticks]) for ticks in probes if found.probed[ticks[0]]]
            moved = max(during, default=np.nan)
            rows.append((error, 1e6 * moved, len(found.K)))
            print(f"  seed {seed}, {tendons} tendons: K {drawn.K:.3f}, model {drawn.K_model:.3f}, "
                  f"error {error:+.1%} by {len(found.K)} probes, T_out {found.error:+.1%}, "
                  f"tip moved {1e6 * moved:.1f} um during a probe, "
                  f"{1e6 * np.ptp(found.tip):.0f} um in all", flush=True)  # fmt: skip
    for tendons, rows in results.items():
        error, moved, count = np.array(rows).T
        size, name = np.abs(error), ("single", "pair")[tendons - 1]
        print(f"{name}: |error of K| median {np.nanmedian(size):.1%}, most {np.nanmax(size):.1%}, "
              f"{np.mean(size <= 0.05):.0%} within 5 %; tip moved {np.nanmax(moved):.1f} um "
              "during probes; "
              f"{count.min():.0f} to {count.max():.0f} probes")  # fmt: skip


if __name__ == "__main__":
    main()
