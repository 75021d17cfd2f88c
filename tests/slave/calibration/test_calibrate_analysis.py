"""What the analysis finds on simulated sheaths, against the numbers these were made of."""

import math
from functools import cache

import numpy as np
import pytest

from slave.calibration.analysis import analyse_procedure
from slave.calibration.config import KnownSheathConfig
from slave.calibration.procedure_state import Phase
from slave.calibration.run import CalibrationRefused
from slave.calibration.tendon_identification import (
    PulledTendon,
    build_tendon_calibration,
    extract_loops,
)
from slave.calibration.tendon_identification import calibrate_tendon as calibrated_by_loop
from slave.simulation.environment import TissueConfig, WallConfig
from tests.slave.calibration.calibration_bench import (
    EA,
    LENGTH,
    QUICK,
    RANGE,
    TIGHT_FIRST,
    but,
    calibrated,
    joint,
    rig_config,
)

KNOWN = KnownSheathConfig(LENGTH, EA)
TIGHT_LAST = TIGHT_FIRST[::-1]
SPRING = joint(tendons=1, body={"spring": 150.0, "pretension": 1.0})


@cache
def record(bent, initialise=QUICK):
    return calibrated(rig_config(bent), initialise, rate_hz=500.0).record


def direction_a(bent, known=KNOWN):
    """Return what tendon a's loop says, and the model that the estimator gets of it."""
    pulled = PulledTendon(record(bent), 0, 0)
    return build_tendon_calibration(pulled, known, calibrated_by_loop(pulled, known, QUICK.low))


def integral(sections, friction, sign):
    """Return ∫ e^(sign s) dx / EA [m/N] by summing up short pieces: M_pull for -1, M_rel for +1."""
    total = s = 0.0
    for section in sections:
        dx = section.length / 4000
        for _ in range(4000):
            ds = friction * dx / section.radius
            total += math.exp(sign * (s + 0.5 * ds)) * dx / EA
            s += ds
    return total


def test_what_may_lie_on_either_side_of_a_turn_is_left_out():
    pulled = PulledTendon(record(joint(1.0, noise=0.03)), 0, 0)
    (loop,) = extract_loops(pulled, QUICK.low)
    steps = np.diff(loop.travel)
    turns = [int(np.argmax(loop.travel)), int(np.argmin(loop.travel[1000:])) + 1000]
    count = 2.0 * np.pi * 0.010 / 67_000
    for turn in turns:
        assert abs(steps[turn]) > 1.5 * count
    assert (
        len(loop.travel) > 0.98 * (pulled.first_pull | pulled.rows(Phase.PULL, Phase.RELEASE)).sum()
    )


@pytest.mark.parametrize(("K", "noise"), [(0.4, 0.01), (1.0, 0.03), (1.5, 0.01)])
def test_an_even_sheath_is_found_by_all_methods(K, noise):
    found, model = direction_a(joint(K, noise=noise))
    assert found.K.value == pytest.approx(K, abs=max(0.01, 3.0 * found.K.uncertainty))
    assert found.K.uncertainty < 0.03
    assert found.K_slopes.value == pytest.approx(K, rel=0.03)
    assert found.K_paper.value == pytest.approx(K, rel=0.02)
    assert found.stiffness_per_length.value == pytest.approx(EA / LENGTH, rel=0.01)
    assert found.M_pull.value == pytest.approx(-math.expm1(-K) / K * LENGTH / EA, rel=3e-3)
    assert found.M_rel.value == pytest.approx(math.expm1(K) / K * LENGTH / EA, rel=0.02)
    assert pytest.approx(found.K.value, rel=1e-4) == model.model().sheath.K
    assert model.axial_stiffness == pytest.approx(EA, rel=0.01)
    assert model.tension_noise == pytest.approx(noise, rel=0.1)
    assert model.displacement_noise < 2e-6


@pytest.mark.parametrize("sections", [TIGHT_FIRST, TIGHT_LAST], ids=["first", "last"])
def test_on_an_uneven_sheath_the_loop_stands_and_what_the_papers_would_do_is_said(sections):
    found, model = direction_a(joint(1.0, sections=sections))
    friction = 1.0 / sum(section.length / section.radius for section in sections)
    assert found.K.value == pytest.approx(1.0, abs=0.02)
    assert found.M_pull.value == pytest.approx(integral(sections, friction, -1.0), rel=5e-3)
    assert found.M_rel.value == pytest.approx(integral(sections, friction, 1.0), rel=0.01)
    assert not found.uniform
    wrong = abs(math.expm1(found.K.value - found.K_paper.value))
    assert wrong > 0.2
    assert "bent unevenly" in found.remark
    assert f"T_out would be {wrong:.0%} too" in found.remark
    assert pytest.approx(found.K.value, rel=1e-4) == model.model().sheath.K
    assert len(model.model().sheath.sections) > 1


def test_what_is_known_wrongly_of_the_stiffness_is_said():
    found, _ = direction_a(joint(1.0, noise=0.03), KnownSheathConfig(LENGTH, 1.1 * EA, 0.001))
    assert found.K.value == pytest.approx(1.0, abs=0.02)
    assert "6.600 N/mm as it was known" in found.remark


def test_without_the_stiffness_there_is_nothing_by_the_paper():
    found, _ = direction_a(joint(1.0, noise=0.03), KnownSheathConfig(LENGTH))
    assert found.K_paper is None
    assert found.K.value == pytest.approx(1.0, abs=0.02)


def test_a_cell_that_is_not_quite_tared_shows_while_slack_and_spoils_nothing():
    found, _ = direction_a(joint(bias=0.05))
    assert found.zero == pytest.approx(0.05, abs=0.005)
    assert found.K.value == pytest.approx(1.0, abs=0.02)


def test_joint_friction_and_a_spring_spoil_nothing():
    found, _ = direction_a(joint(body={"friction": 1.0, "spring": 50.0}))
    assert found.K.value == pytest.approx(1.0, abs=0.02)


def test_both_tendons_tell_how_far_the_joint_goes():
    (result,) = analyse_procedure(record(joint(1.0, noise=0.03)), QUICK)
    assert result.range == pytest.approx(RANGE, rel=0.01)
    assert [direction.tendon for direction in result.directions] == ["a", "b"]


def test_one_tendon_and_a_return_spring_are_calibrated_too():
    (result,) = analyse_procedure(record(SPRING), QUICK)
    assert result.directions[0].K.value == pytest.approx(1.0, abs=0.04)
    assert result.range == pytest.approx(RANGE / 2, rel=0.02)


SOFT = {
    "m >= 1": (
        WallConfig(position=0.005, stiffness=5000.0),
        r"joint 1, tendon a: M_pull EA/L is 1\.\d\d, must be below 1",
    ),
    "tissue": (TissueConfig(position=0.005, stiffness=1e6), "joint 1, tendon a: .*something soft"),
}


@pytest.mark.parametrize("case", SOFT)
def test_something_soft_is_not_taken_for_a_stop(case):
    environment, said = SOFT[case]
    with pytest.raises(CalibrationRefused, match=said):
        direction_a(joint(environment=environment))


def test_a_cell_to_be_tared_is_refused():
    with pytest.raises(
        CalibrationRefused, match=r"the load cell reads 0.25 N while the tendon is slack"
    ):
        direction_a(joint(bias=0.25))


def test_too_little_range_is_refused():
    found = record(joint(2.0), but(QUICK, low=0.5))
    with pytest.raises(
        CalibrationRefused, match=r"joint 1, tendon a: .*raise slave.initialise.tension"
    ):
        calibrated_by_loop(PulledTendon(found, 0, 0), KnownSheathConfig(LENGTH, EA), 0.5)


def test_a_stop_that_comes_too_early_is_refused_where_the_range_is_known():
    blocked = record(joint(environment=WallConfig(position=0.005, stiffness=1e6)))
    said = r"joint 1: it travels 20\.\d mm between its stops, expected 30.0 mm"
    with pytest.raises(CalibrationRefused, match=said):
        analyse_procedure(blocked, but(QUICK, range=RANGE))
    with pytest.raises(CalibrationRefused, match="by the earlier calibration"):
        analyse_procedure(blocked, QUICK, [RANGE])


def test_a_joint_that_does_not_move_is_refused():
    with pytest.raises(CalibrationRefused, match=r"joint 1: it moved only 0\.\d mm"):
        analyse_procedure(record(joint(body={"friction": 30.0})), QUICK)
