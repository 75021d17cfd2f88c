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
    pretension = np.full(len(time), 5.0)  # [N], which the first sample gives
    commanded = est.PairRecord(
        bend, time, np.sin(time), np.zeros(len(time)), pretension, pretension
    )
    angle, a, b = simulate_by_command(true, commanded)
    cell_noise = noise.normal(0.0, 0.02, (2, len(time)))
    return commanded._replace(angle=angle, tension_a=a + cell_noise[0], tension_b=b + cell_noise[1])


study = est.study_pair([record(bend) for bend in (0.0, 1.5, 3.0)], validate=[record(2.2)])
print(f"K grows by {study.growth.value:.2f} per radian ({true.growth} was put in)")
print(f"a bend kept apart: {study.validation[0].model_error.share:.1%} of the span")
est.plot_result(study)  # a figure; in a notebook, est.show_result(study) shows all of them
