"""Hidden changes of a simulated arm of two joints are named with the joint or the tendon."""

import numpy as np
import pytest

from estimator.diagnosis.arm_report import format_arm_summary
from studies.hidden_effects import arms
from studies.hidden_effects.arms import Change, Shape

SHAPE = Shape(((0.005, 0.0), (-0.004, 0.005)), friction=0.15, wrap=0.5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (Change(), "Nothing is wrong with the arm beyond noise."),
        pytest.param(
            Change("friction", joint=0),
            "friction of tendons that pass joint 1 is 0.2",
            marks=pytest.mark.slow,
        ),
        (Change("gain", row=1, side=1), "tendon 2b: the load cell at the housing has a wrong gain"),
    ],
    ids=lambda value: getattr(value, "kind", ""),
)
def test_a_change_is_named_with_its_joint_or_tendon(change, words):
    found = arms.diagnose(SHAPE, arms.make(SHAPE, change, seed=5, duration=12.0))
    assert arms.is_right(SHAPE, change, found)
    assert words in format_arm_summary(found)
    assert all(tendon.is_explained for tendon in found.tendons)
    assert max(tendon.after["distal_displacement"] for tendon in found.tendons) < 2.4e-6  # noise


def test_without_angles_and_anchor_tension_the_report_says_what_cannot_be_told():
    record = arms.make(SHAPE, Change(), seed=6, duration=12.0)
    routing, sheaths, names = arms.describe_known(SHAPE)
    travel = record.angles @ np.asarray(routing.radii).T
    data = arms.arm_model.ArmData(
        record.time, record.proximal_tension, record.proximal_displacement, None,
        travel @ np.linalg.pinv(np.asarray(routing.radii)).T, False, False, names,
    )  # fmt: skip
    found = arms.diagnose_arm(data, routing, sheaths)
    assert found.is_clean
    summary = format_arm_summary(found)
    assert "joint_angle_1_rad" in summary
    assert "anchor_tension_N" in summary
