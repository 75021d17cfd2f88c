"""K of two antagonists from a drag, against tensions built up piece by piece along the sheaths."""

import numpy as np
import pytest

from estimator.calibration.calibration import CalibrationError
from estimator.calibration.drag import fit_friction_sum

N, PIECES = 2000, 20_000
RISE_AND_FALL = np.concatenate(
    [np.linspace(0.1, 2.0, N // 2), np.linspace(2.0, 0.1, N // 2)]
)  # [N]
TRAVEL = np.linspace(0.0, 0.01, N)  # [m]


def along(tension, friction):
    """Return the tension [N] at the end of a sheath that is slid through, against its friction."""
    for _ in range(PIECES):
        tension = tension * (1.0 + friction / PIECES)
    return tension


def drag(K_a, K_b, joint=0.0, spring=0.0, noise=0.0):
    drawn = RISE_AND_FALL
    pulled = along(along(drawn, K_b) + joint + spring * TRAVEL, K_a)
    random = np.random.default_rng(1)
    return pulled + noise * random.standard_normal(N), drawn + noise * random.standard_normal(N)


@pytest.mark.parametrize(
    ("K_a", "K_b", "resists"),
    [(1.0, 1.0, {}), (0.2, 0.6, {"joint": 0.5}), (1.7, 1.5, {"joint": 0.3, "spring": 50.0})],
)
def test_both_k_are_found_whatever_the_joint_itself_takes(K_a, K_b, resists):
    found = fit_friction_sum(*drag(K_a, K_b, **resists), TRAVEL)
    assert found.value == pytest.approx(K_a + K_b, abs=1e-3)


def test_noise_is_within_the_uncertainty_that_is_stated():
    found = fit_friction_sum(*drag(1.2, 1.2, noise=0.03), TRAVEL)
    assert found.value == pytest.approx(2.4, abs=3.0 * found.uncertainty)
    assert found.uncertainty < 0.006


def test_a_tendon_that_does_not_slide_is_no_drag():
    pulled, drawn = drag(1.0, 1.0)
    stuck = np.minimum(drawn, 1.0)
    with pytest.raises(CalibrationError, match="does not slide"):
        fit_friction_sum(pulled, stuck, TRAVEL)


def test_a_tendon_whose_tension_does_not_follow_is_no_drag():
    pulled, drawn = drag(1.0, 1.0)
    with pytest.raises(CalibrationError, match="of the change of tension"):
        fit_friction_sum(pulled, 2.0 - drawn, TRAVEL)
