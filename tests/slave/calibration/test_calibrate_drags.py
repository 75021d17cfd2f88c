"""What drags add to the loops, on simulated joints whose K is known."""

import dataclasses
from functools import cache

import pytest

from slave.calibration.analysis import combine_with_drags
from slave.calibration.config import KnownSheathConfig
from slave.calibration.procedure_state import Phase
from slave.calibration.tendon_identification import PulledTendon
from slave.calibration.tendon_identification import calibrate_tendon as by_loop
from slave.sheath_section import SectionConfig
from tests.slave.calibration.calibration_bench import (
    KNOWN,
    LENGTH,
    but,
    calibrated,
    joint,
    rig_config,
)

FULL = but(KNOWN, loops=1)
SLIGHT = (SectionConfig(0.25), SectionConfig(1.06, 0.066), SectionConfig(0.20, 0.53))
TIP = (SectionConfig(1.0, 0.4), SectionConfig(0.42, 0.3), SectionConfig(0.03, 0.02))
GAINS = 0.002


@cache
def record(sections, K=1.2, initialise=FULL):
    nodes = 120 if sections is TIP else 60  # a bend of 30 mm needs more than one
    rig = rig_config(joint(K, sections=sections, nodes=nodes), period=1e-3)
    return calibrated(rig, initialise).record


@cache
def loops(sections):
    known = KnownSheathConfig(LENGTH)
    return [by_loop(PulledTendon(record(sections), 0, side), known, FULL.low) for side in (0, 1)]


def dragged(sections, pulled=1.0, a=1.0, gain_error=GAINS):
    """Return K by the loops as they were, and drags whose readings are scaled.

    `pulled` scales the tension of whichever tendon is pulled in a drag, `a` that of tendon a.
    """
    found = record(sections)
    tension = found.tension.copy()
    drag = found.phase[:, 0] == Phase.DRAG
    for side in (0, 1):
        tension[drag & (found.side[:, 0] == 2 + side), side] *= pulled
    tension[drag, 0] *= a
    changed = dataclasses.replace(found, tension=tension)
    both = [PulledTendon(changed, 0, side) for side in (0, 1)]
    right, remark = combine_with_drags(both, loops(sections), gain_error)
    return [one.K for one in right], remark


@pytest.mark.parametrize("sections", [SLIGHT, pytest.param(TIP, marks=pytest.mark.slow)])
def test_friction_that_hides_at_the_tip_is_found(sections):
    right, remark = dragged(sections)
    assert remark == ""
    assert sum(K.value for K in right) == pytest.approx(2.4, abs=0.006)
    errors = [abs(K.value - 1.2) for K in right]
    assert all(error < 2.0 * K.uncertainty for error, K in zip(errors, right, strict=True))
    by_the_loops = [one.K.value for one in loops(sections)]
    assert abs(sum(by_the_loops) - 2.4) > 0.02
    assert max(errors) < 0.5 * max(abs(K - 1.2) for K in by_the_loops)


def test_a_joint_whose_friction_grows_with_its_load_is_left_to_the_loops():
    right, remark = dragged(SLIGHT, pulled=1.1)
    assert right == [one.K for one in loops(SLIGHT)]
    assert "drags not used" in remark
    assert "by the drags" in remark


def test_gains_that_differ_by_more_than_was_stated_are_found_out():
    right, remark = dragged(SLIGHT, a=1.03)
    assert right == [one.K for one in loops(SLIGHT)]
    assert "as a draws b" in remark


@pytest.mark.slow
def test_one_drag_alone_puts_right_as_much_as_the_gains_are_known():
    quick = record(SLIGHT, initialise=but(FULL, drags=1))
    both = [PulledTendon(quick, 0, side) for side in (0, 1)]
    assert not both[1].dragging.any()
    by_the_loops = sum(one.K.value for one in loops(SLIGHT))
    known, unknown = (
        sum(one.K.value for one in combine_with_drags(both, loops(SLIGHT), gain_error)[0])
        for gain_error in (0.0, 0.2)
    )
    assert known == pytest.approx(2.4, abs=0.006)
    assert unknown == pytest.approx(by_the_loops, abs=0.25 * abs(by_the_loops - 2.4))
