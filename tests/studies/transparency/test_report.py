"""What the study writes of what was measured, and that a measurement runs the live loops."""

import math

import numpy as np

from studies.transparency import report, study
from studies.transparency.hybrid import Hybrid, Response
from studies.transparency.stiffness import SpringContact
from studies.transparency.study import HANDS, Case, Study, Task, Walls
from studies.transparency.zwidth import Width


def case(commanded, name, delay):
    """Return a case as a study could have found it: ideal, but for what is set here."""
    frequency = commanded.excitation.frequency
    late = np.exp(-2j * np.pi * frequency * delay / 2)
    scale = commanded.force_scale * commanded.position_scale
    ends = {"direct": Width(0.0, commanded.lowest), "wave": Width(commanded.cap, math.inf)}
    trusted = np.where(frequency < 10.0, 1.0, 0.5)

    def answers(value):
        return Response(value + 0j * frequency, trusted, 0.02)

    return Case(
        name,
        delay,
        tuple(SpringContact(k, scale * k * 0.9, 0.9, 0.1) for k in commanded.stiffnesses),
        {
            (hand, b): Walls(ends.get(name, Width(300.0, 350.0)), math.nan)
            for hand in HANDS
            for b in commanded.dampings
        },
        Hybrid(
            frequency,
            answers(0.5),
            answers(commanded.force_scale * late),
            answers(-commanded.position_scale * late),
            answers(-0.001),
        ),
    )


def test_tables_tell_widths_quality_and_where_llewellyn_applies():
    commanded = Study(couplings=("direct", "wave"), round_trips=(0.0, 0.1))
    cases = [case(commanded, n, d) for n in commanded.couplings for d in commanded.round_trips]
    text = report.format_tables(commanded, cases)
    assert text.count("## ") == 4
    assert "≥ 10000" in text
    assert "< 100" in text
    assert "0.50, 2.0 %" in text  # coherence and distortion
    assert text.count("does not apply") == 2  # to waves
    assert text.count("fails at 9 of 9 lines") == 2  # Re h22 < 0
    noisy = Study(couplings=("direct",), round_trips=(0.1,), loss=0.1)
    assert "does not apply" in report.format_tables(noisy, [case(noisy, "direct", 0.1)])


def test_a_measurement_runs_the_live_loops():
    commanded = Study(cap=200.0, lowest=200.0)
    found = study.measure_task(commanded, Task("zwidth", "direct", 0.0, "firm", 5.0))
    assert found.width == Width(200.0, math.inf)
    assert 0.0 < found.buzz < 0.05
