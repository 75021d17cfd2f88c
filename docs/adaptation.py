"""A picture of docs/explanation/estimator.md, a sheath that moves: `python -m docs.adaptation`.

A tip is pressed against a wall again and again while all friction grows by 40 % within 4 s; shown
are T_out, and the force that is rendered, with the K of the calibration and with adaptation. The
plant is that of `studies.adaptation`; samples are estimated as by a slave. No clock and a fixed
seed: the same picture on every run, in half a minute.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from estimator.adaptation import AdaptedRun, run_adapting
from estimator.array_types import Array
from estimator.figure_style import STYLE
from estimator.online import online
from estimator.online.online import Estimates
from slave.config import SlaveConfig, load_tendon_configs
from slave.rigs.simulated import SimulatedRigConfig, build_joint
from slave.simulation.environment import TissueConfig
from slave.simulation.joint import init_joint
from slave.simulation.tendon import divide_sheath
from studies.adaptation import NOISE_M, NOISE_N, RATE, render, run_plant
from teleop.config.loading import load

ROOT = Path(__file__).parents[1]
IMAGE = ROOT / "docs" / "images" / "adaptation.png"
CHANGE, CHANGE_S, GROW_S, END_S = 0.4, 20.0, 4.0, 50.0
PERIOD_S, REACH = 1.6, 0.011  # [s] of a press, [m] of the motor
WALL = TissueConfig(position=0.003, stiffness=2000.0, exponent=1.0)
WINDOWS = (("before", 16.4, 20.0), ("while it moves", 20.0, 26.4), ("after", 46.4, 50.0))  # [s]
TRUE, FIXED = "#E69F00", "#D55E00"  # Okabe and Ito
ADAPTED, RENDERED = "#0072B2", "#56B4E9"


class Press(NamedTuple):
    """A record of presses, estimated in two ways."""

    time: Array  # [s]
    tip: Array  # [N] true
    K: Array  # true
    fixed: Estimates
    adapted: AdaptedRun


def simulate() -> Press:
    """Return presses against a wall while the sheath of configs/demo.yaml moves."""
    config = load(ROOT / "configs" / "demo.yaml", SlaveConfig, "slave")
    if not isinstance(config.rig, SimulatedRigConfig):
        raise TypeError("demo.yaml has a simulated rig")
    (joint_config,), (tendon,) = config.rig.joints, load_tendon_configs(config, 1)
    joint = build_joint(replace(joint_config, environment=WALL))
    model = replace(tendon, tension_noise=NOISE_N, displacement_noise=NOISE_M).build_model()
    sheath = joint_config.tendons[0].sheath
    friction = sheath.friction * divide_sheath(sheath)[1]
    t = np.arange(round(END_S * RATE)) / RATE
    hand = 0.5 * REACH * 2.0 * np.pi / PERIOD_S * np.sin(2.0 * np.pi * t / PERIOD_S)
    changes = (friction, friction), (np.full(len(friction), CHANGE),) * 2
    truth = run_plant(joint, init_joint(joint), *changes, CHANGE_S, GROW_S, hand, 1.0 / RATE)
    noise = np.random.default_rng(1).normal(0.0, 1.0, (2, len(t)))
    T, q = truth[:, 0, 0] + NOISE_N * noise[0], truth[:, 1, 0] + NOISE_M * noise[1]
    grown = np.clip((t - CHANGE_S) / GROW_S, 0.0, 1.0)
    fixed = online.run(online.prepare(model), t, T, q)
    K = model.sheath.K * (1.0 + CHANGE * grown)
    return Press(t, truth[:, 2, 0], K, fixed, run_adapting(model, t, T, q))


def draw(press: Press) -> Figure:
    """Return the figure: the force in three stretches of time, K over all."""
    figure = Figure(figsize=(7.2, 4.6))
    parts = figure.subplot_mosaic(
        [[name for name, _, _ in WINDOWS], ["K"] * len(WINDOWS)], height_ratios=[1.5, 1.0]
    )
    lines = (
        (press.tip, TRUE, "true", 4.0),
        (press.fixed.distal_tension, FIXED, "estimated, K as calibrated", 1.2),
        (press.adapted.estimates.distal_tension, ADAPTED, "estimated, adapted", 1.2),
        (render(press.adapted.estimates), RENDERED, "rendered, adapted", 0.8),
    )
    top = 1.1 * max(values[press.time > WINDOWS[0][1]].max() for values, *_ in lines)
    for name, begin, end in WINDOWS:
        chosen = (press.time >= begin) & (press.time <= end)
        for values, colour, label, width in lines:
            parts[name].plot(
                press.time[chosen], values[chosen], color=colour, label=label, lw=width
            )
        parts[name].set(title=name, ylim=(0.0, top), xlabel="time [s]")
    parts["before"].set_ylabel("force [N]")
    adapted = press.adapted
    parts["K"].fill_between(press.time, adapted.K_low, adapted.K_high, color=ADAPTED, alpha=0.15)
    parts["K"].plot(press.time, press.K, color=TRUE, lw=4.0)
    parts["K"].axhline(press.K[0], color=FIXED, lw=1.2)
    parts["K"].plot(press.time, adapted.K, color=ADAPTED, lw=1.2)
    parts["K"].set(ylabel="K", xlabel="time [s]", xlim=(0.0, END_S))
    figure.legend(*parts["before"].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def main() -> None:
    """Draw the picture and print its figures."""
    press = simulate()
    full = press.tip.max()
    for name, begin, end in WINDOWS:
        chosen = (press.time >= begin) & (press.time <= end)
        for label, run in (("fixed", press.fixed), ("adapted", press.adapted.estimates)):
            error = np.abs(run.distal_tension - press.tip)[chosen] / full
            inside = (run.low <= press.tip) & (press.tip <= run.high)
            rendered = render(run)[chosen].mean() / press.tip[chosen].mean()
            print(
                f"{name}, {label}: error of T_out, mean {error.mean():.1%}, 90 % below "
                f"{np.percentile(error, 90):.1%} of the largest force; inside its interval "
                f"{inside[chosen].mean():.1%}; rendered {rendered:.0%} of the true force"
            )
    with mpl.rc_context(STYLE):
        draw(press).savefig(IMAGE)


if __name__ == "__main__":
    main()
