"""A pair of tendons at three bends: how its friction grows, and a fourth bend predicted.

    python examples/pair_study.py

The records are simulated with the model of a pair, and noise.
"""

import numpy as np

import estimator as est
from estimator.pair.pair_model import PairModel, simulate_by_command

true = PairModel(
    friction=0.3, growth=0.2, compliance=0.5, bedding=0.0,
    stiffness=7.0, joint_friction=0.5, neutral=0.0,
)  # fmt: skip
time = np.linspace(0.0, 12.6, 60)
noise = np.random.default_rng(0)


def record(bend: float) -> est.PairRecord:
    still = np.full(len(time), 5.0)  # [N] of pretension, which the first sample gives
    asked = est.PairRecord(bend, time, np.sin(time), np.zeros(len(time)), still, still)
    angle, a, b = simulate_by_command(true, asked)
    unsure = noise.normal(0.0, 0.02, (2, len(time)))
    return asked._replace(angle=angle, tension_a=a + unsure[0], tension_b=b + unsure[1])


found = est.study_pair([record(bend) for bend in (0.0, 1.5, 3.0)], validate=[record(2.2)])
print(f"K grows by {found.growth.value:.2f} per radian ({true.growth} was put in)")
print(f"a bend kept apart: {found.validation[0].model_error.share:.1%} of the span")
est.plot_result(found)  # a figure; in a notebook, est.show_result(found) shows all of them
