"""How well joints follow their commands, with and without making up for elongation.

python -m studies.tracking

On the simulated rig: two tendons a joint, the motors' own lag and speed limit, 0.02 N of noise on
the load cells. The estimator believes K to be 2 % and EA to be 3 % higher or lower than they are,
whichever is worse. A spring loads the joint so that some 5 N at the housing hold it at 6 mm.
Takes 4 minutes.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import jit_compile
from estimator.law.sheath import Sheath
from estimator.online import online
from estimator.structs import StructArray, to_struct_array
from slave import control, fault_detection, gate
from slave.control import ControlConfig, ControllerState, JointEstimate
from slave.fault_detection import FaultDetectionConfig, FaultDetector, MotorChecks
from slave.gate import GateConfig
from slave.rig_layout import EstimatedTendon, RigLayout, build_rig_layout
from slave.rigs.simulated import JointConfig
from slave.sheath_section import SectionConfig
from studies.testbed.command import measure_us, parse_options
from studies.testbed.control_bench import (
    DT,
    Command,
    build_joint,
    build_sine,
    build_stairs,
    follow,
)
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS

SHEATH = Sheath.uniform(1.0, 1.5, 9000.0)
STEPS = (0.004, 0.002, 0.006, 0.0, -0.006, 0.0)  # [m]


class Motion(NamedTuple):
    """What a joint is asked to do, and for how long [s]."""

    command: Command
    seconds: float


MOTIONS = {
    "sine, 6 mm, 0.25 Hz": Motion(build_sine(0.006, 0.25), 5.0),
    "staircase, 5 mm/s": Motion(build_stairs(STEPS, 0.005, 0.4), 8.0),
    "staircase, 10 mm/s": Motion(build_stairs(STEPS, 0.010, 0.4), 5.0),
    "sine, 6 mm, 1 Hz": Motion(build_sine(0.006, 1.0), 3.0),
}
STAIRS = MOTIONS["staircase, 5 mm/s"]
ERRORS = ((1.02, 1.03), (0.98, 0.97))
BENDS = {
    "tight at the motor": (SectionConfig(0.2, 0.05), SectionConfig(1.3, 0.5)),
    "tight at the tip": (SectionConfig(1.3, 0.5), SectionConfig(0.2, 0.05)),
}


def build_loaded(K: float, **settings: float) -> JointConfig:
    return build_joint(K, spring=900.0 * math.exp(-K), nodes=40, **settings)


def find_worst(
    joints: list[JointConfig], motions: list[Motion], config: ControlConfig
) -> list[tuple[float, float]]:
    """Return the RMS and largest error of each joint [m], with the worse of the two models."""
    commands, seconds = [m.command for m in motions], max(m.seconds for m in motions)
    runs = [follow(joints, commands, seconds, config, errors=errors) for errors in ERRORS]
    errors = [[run.error(k) for run in runs] for k in range(len(joints))]
    return [(max(rms for rms, _ in e), max(most for _, most in e)) for e in errors]


def print_comparison(
    name: str, joints: list[JointConfig], motions: list[Motion], **config: float
) -> None:
    off = find_worst(joints, motions, ControlConfig(compensation=0.0, **config))
    on = find_worst(joints, motions, ControlConfig(**config))
    for k, (without, made_up) in enumerate(zip(off, on, strict=True)):
        label = name if len(joints) == 1 else f"{name}, joint {k + 1}"
        errors = "".join(f"{rms * 1e6:8.0f}{most * 1e6:7.0f}" for rms, most in (without, made_up))
        ratios = f"{without[0] / made_up[0]:8.1f}{without[1] / made_up[1]:7.1f}"
        print(f"{label:<44}{errors}{ratios}", flush=True)


def print_variation(title: str, name: str, values: tuple[float, ...], motion: Motion) -> None:
    print(f"\n{title}, K = 1")
    for value in values:
        ((rms, most),) = find_worst([build_loaded(1.0)], [motion], ControlConfig(**{name: value}))
        print(f"{value:>10}{rms * 1e6:8.0f}{most * 1e6:7.0f}", flush=True)


@jit_compile
def run_detection(
    config: Sequence[FaultDetectionConfig],
    layout: Sequence[RigLayout],
    detector: Sequence[FaultDetector],
    motors: Sequence[MotorChecks],
    tendons: Sequence[EstimatedTendon],
    sent: NDArray[np.float64],
    ticks: int,
) -> None:
    """Do what fault detection does in a tick with one sample, so many times."""
    for k in range(ticks):
        for i in range(layout[0].tendons):
            tendons[i].tension = 5.0 + 0.001 * (k % 7)
        fault_detection.step(config[0], layout[0], detector[0], tendons, DT)
        fault_detection.record_motor_readings(motors[0], layout[0], tendons, sent)
        fault_detection.check_motors(config[0], motors[0], layout[0], sent, True, True, DT)


def prepare_detection(
    joints: tuple[tuple[int, int], ...], models: list[online.TendonModel]
) -> tuple[StructArray, StructArray, StructArray, StructArray, StructArray, NDArray[np.float64]]:
    tendons = EstimatedTendon.array(MAX_TENDONS)
    tendons["tension"], tendons["displacement"], tendons["valid"] = 5.0, 0.0, True
    settings = to_struct_array(FaultDetectionConfig())
    detector, motors = fault_detection.init_detector(models), MotorChecks.array()
    return settings, build_rig_layout(joints), detector, motors, tendons, np.zeros(MAX_TENDONS)


def print_costs() -> None:
    """Print what a tick of four joints costs, beside the estimators that it needs anyway."""
    joints = tuple((k, k + 1) for k in range(0, 8, 2))
    prepared = [online.prepare(online.TendonModel(SHEATH))] * 8
    state = online.build_initial_state(prepared[0])
    estimate, state = online.step(prepared[0], state, 5.0, 0.0, 0.0)
    layout, config, limits = (
        build_rig_layout(joints)[0],
        to_struct_array(ControlConfig())[0],
        to_struct_array(GateConfig())[0],
    )  # fmt: skip
    memory, seen = ControllerState.array()[0], EstimatedTendon.array(MAX_TENDONS)
    seen["tension"][:8], seen["displacement"], seen["valid"] = 5.0 + np.arange(8), 0.0, True
    seen["estimate"]["elongation"] = estimate.elongation
    no_arm = np.full((3, MAX_JOINTS), np.nan)
    still, zeros, wanted = np.zeros(MAX_TENDONS), np.zeros(MAX_JOINTS), np.zeros(MAX_TENDONS)
    known, reach = JointEstimate.array(MAX_JOINTS), gate.Reach.array(MAX_TENDONS)
    drive = partial(
        control.step, config, layout, memory, zeros, zeros, still, seen, True, DT, wanted
    )
    drive()
    detection = prepare_detection(joints, [online.TendonModel(SHEATH)] * 8)
    calls = {
        "online.step, 8 tendons": lambda: [
            online.step(prepared[0], state, 5.0, 0.0, DT) for _ in range(8)
        ],
        "control.step": drive,
        "control.joint_estimates": lambda: control.estimate_joints(
            layout, seen, zeros, no_arm, known
        ),
        "gate.reaches": lambda: gate.compute_reaches(limits, layout, known, reach),
        "gate.step": lambda: gate.step(
            limits,
            8,
            still,
            wanted,
            seen["tension"].copy(),
            0.0,
            True,
            DT,
            reach,
            True,
            False,
            wanted,
        ),
        "fault detection, 1000 times": partial(run_detection, *detection, 1000),
    }
    print("\na tick of four joints [us]")
    for name, call in calls.items():
        print(f"{name:<24}{measure_us(call, 200, 20):8.1f}")


def main() -> None:
    parse_options(__doc__)
    print_costs()
    print(f"{'tracking error [um]':<44}{'without':>15}{'with':>15}{'times smaller':>15}")
    print(f"{'':<44}" + f"{'RMS':>8}{'max':>7}" * 3)
    for name, motion in MOTIONS.items():
        for K in (0.4, 0.8, 1.2, 1.8):
            print_comparison(f"{name}, K = {K}", [build_loaded(K)], [motion])
    print_comparison(
        "staircase, K = 1.8, slack side at 0.15 N",
        [build_loaded(1.8)],
        [STAIRS],
        slack_side_tension=0.15,
    )
    for name, sections in BENDS.items():
        bent = build_joint(1.0, 330.0, sections=sections, nodes=40)
        print_comparison(f"staircase, {name}", [bent], [STAIRS])
    alone = build_joint(0.4, 600.0, tendons=1, pretension=2.0, nodes=40)
    print_comparison(
        "staircase, one tendon, K = 0.4",
        [alone],
        [Motion(build_stairs(STEPS[:4], 0.005, 0.4), 5.0)],
    )
    arm = [build_loaded(K) for K in (0.4, 0.8, 1.2, 1.6)]
    shares = (1.0, 0.8, -0.9, 0.7)
    stairs = [tuple(share * level for level in STEPS) for share in shares]
    print_comparison(
        "four, stairs", arm, [Motion(build_stairs(s, 0.005, 0.4), 8.0) for s in stairs]
    )
    print_comparison(
        "four, sines", arm, [Motion(build_sine(0.006, f), 5.0) for f in (0.25, 0.3, 0.2, 0.35)]
    )
    print_variation("g, staircase", "compensation", (0.0, 0.5, 0.8, 0.9, 0.95, 0.98), STAIRS)
    print_variation(
        "lead [s], sine of 0.25 Hz",
        "lead",
        (0.0, 0.005, 0.010, 0.0125, 0.015),
        MOTIONS["sine, 6 mm, 0.25 Hz"],
    )


if __name__ == "__main__":
    main()
