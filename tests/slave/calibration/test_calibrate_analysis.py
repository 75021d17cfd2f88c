"""What the analysis finds on simulated sheaths, against the numbers these were made of."""

import math
from contextlib import nullcontext
from functools import cache

import pytest

from slave.calibration.analysis import analyse_procedure
from slave.calibration.config import KnownSheathConfig
from slave.calibration.procedure_run import CalibrationRefused
from slave.calibration.tendon_identification import (
    PulledTendon,
    build_tendon_calibration,
)
from slave.calibration.tendon_identification import calibrate_tendon as calibrated_by_loop
from slave.rigs.simulated import SimulatedRig
from slave.simulation.environment import TissueConfig, WallConfig
from slave.simulation.sensing_loop import SensingLoopConfig
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
SPRING = joint(tendons=1, body={"spring": 150.0, "pretension": 1.0})


@cache
def record(bent, initialise=QUICK):
    return calibrated(rig_config(bent), initialise, rate_hz=250.0).record


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


def test_the_friction_of_a_sensing_loop_is_found_beside_that_of_its_tendon():
    (tendon,), loop = SPRING.tendons, SensingLoopConfig(friction=0.06)
    rig = SimulatedRig(rig_config(but(SPRING, tendons=(but(tendon, loop=loop),))))
    pulled = PulledTendon(calibrated(rig, rate_hz=250.0).record, 0, 0)
    _, model = build_tendon_calibration(pulled, KNOWN, calibrated_by_loop(pulled, KNOWN, QUICK.low))
    (section,) = tendon.sheath.sections
    there_and_back = 2.0 * loop.friction * section.length / section.radius
    assert model.loop_friction == pytest.approx(there_and_back, rel=0.03)
    assert direction_a(SPRING)[1].loop_friction == 0.0


def test_an_even_sheath_is_found_by_all_methods():
    K, noise = 1.0, 0.03
    found, model = direction_a(joint(K, noise=noise))
    assert found.K.value == pytest.approx(K, abs=max(0.01, 3.0 * found.K.uncertainty))
    assert found.K.uncertainty < 0.03
    assert found.K_slopes.value == pytest.approx(K, rel=0.03)
    assert found.K_paper.value == pytest.approx(K, rel=0.02)
    assert found.stiffness_per_length.value == pytest.approx(EA / LENGTH, rel=0.01)
    assert found.M_pull.value == pytest.approx(-math.expm1(-K) / K * LENGTH / EA, rel=3e-3)
    assert found.M_rel.value == pytest.approx(math.expm1(K) / K * LENGTH / EA, rel=0.02)
    assert pytest.approx(found.K.value, rel=1e-4) == model.build_model().sheath.K
    assert model.axial_stiffness == pytest.approx(EA, rel=0.01)
    assert model.tension_noise == pytest.approx(noise, rel=0.1)
    assert model.displacement_noise < 2e-6


@pytest.mark.slow
def test_on_an_uneven_sheath_the_loop_stands_and_what_the_papers_would_do_is_said():
    sections = TIGHT_FIRST
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
    assert pytest.approx(found.K.value, rel=1e-4) == model.build_model().sheath.K
    assert len(model.build_model().sheath.sections) > 1


@pytest.mark.slow
def test_one_tendon_and_a_return_spring_are_calibrated_too():
    (result,) = analyse_procedure(record(SPRING), QUICK)
    assert result.directions[0].K.value == pytest.approx(1.0, abs=0.04)
    assert result.range == pytest.approx(RANGE / 2, rel=0.02)


@pytest.mark.slow
def test_something_soft_is_not_taken_for_a_stop():
    tissue = TissueConfig(position=0.005, stiffness=1e6)
    with pytest.raises(CalibrationRefused, match=r"joint 1, tendon a: .*something soft"):
        direction_a(joint(environment=tissue))


@pytest.mark.slow
def test_a_cell_to_be_tared_is_refused():
    with pytest.raises(
        CalibrationRefused, match=r"the load cell reads 0.25 N while the tendon is slack"
    ):
        direction_a(joint(bias=0.25))


@pytest.mark.slow
def test_a_stop_that_comes_too_early_is_refused_where_the_range_is_known():
    blocked = record(joint(environment=WallConfig(position=0.005, stiffness=1e6)))
    said = r"joint 1: it travels 20\.\d mm between its stops, expected 30.0 mm"
    with pytest.raises(CalibrationRefused, match=said):
        analyse_procedure(blocked, but(QUICK, range=RANGE))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("travel", "refused"),
    [((RANGE, RANGE / 2), None), (None, None), ((RANGE, RANGE), "joint 2"),
     (RANGE / 2, "joint 1")],
)  # fmt: skip
def test_a_known_range_may_differ_between_joints(travel, refused):
    both = calibrated(rig_config(joint(), SPRING), QUICK, rate_hz=250.0).record
    with pytest.raises(CalibrationRefused, match=refused) if refused else nullcontext():
        results = analyse_procedure(both, but(QUICK, range=travel))
        assert [r.range for r in results] == pytest.approx([RANGE, RANGE / 2], rel=0.02)


@pytest.mark.slow
def test_a_joint_that_does_not_move_is_refused():
    with pytest.raises(CalibrationRefused, match=r"joint 1: it moved only 0\.\d mm"):
        analyse_procedure(record(joint(body={"friction": 30.0})), QUICK)
