"""The whole experiment on a few sheaths: ours is as good as is asked, the paper's is as printed."""

import pytest

from studies.paper import figures, report
from studies.paper.__main__ import run_experiments
from studies.paper.methods import METHODS, OURS, PAPER
from studies.paper.study import MOTIONS, NESTED, PHASES, PROFILE, TARGETS, WHOLE

pytestmark = pytest.mark.slow
SHEATHS = 2


@pytest.fixture(scope="module")
def ran():
    """The sheath of the figures, and two random ones."""
    return run_experiments(SHEATHS, 2, 1)


def test_ours_is_within_what_is_asked_on_every_sheath(ran):
    shown, outcomes = ran
    assert len(outcomes) == SHEATHS
    for outcome in [shown.outcome, *outcomes]:
        assert report.meets_targets(outcome)
        assert pytest.approx(outcome.specimen.K, rel=0.02) == outcome.results[OURS].K
        for motion in MOTIONS:
            for signal in TARGETS:
                assert getattr(outcome.results[OURS].scores[motion][WHOLE], signal).average > 0.0


def test_the_papers_method_comes_out_as_in_the_paper_on_a_sheath_as_the_papers(ran):
    scores = ran[0].outcome.results[PAPER].scores[PROFILE]
    assert 0.04 < scores[WHOLE].force.largest < 0.12
    assert 0.02 < scores[WHOLE].elongation.largest < 0.06
    assert scores[WHOLE].elongation.largest < scores[WHOLE].force.largest
    assert all(scores[phase].force.average > 0.0 for phase in PHASES)


def test_the_papers_method_fails_where_curvature_is_uneven(ran):
    uneven = [outcome for outcome in ran[1] if abs(outcome.unevenness) > 0.2]
    assert uneven
    for outcome in uneven:
        for method in set(METHODS) - {OURS}:
            for motion in (PROFILE, NESTED):
                assert outcome.results[method].scores[motion][WHOLE].force.largest > 0.07


def test_tables_and_figures_show_all(ran, tmp_path):
    shown, outcomes = ran
    figures.write_figures(shown, outcomes, tmp_path)
    assert len([path for path in tmp_path.glob("*.png") if path.stat().st_size > 10_000]) == 6
    text = report.format_tables(shown.outcome, outcomes, 2)
    assert f"{SHEATHS} of {SHEATHS} sheaths within" in text.partition("|")[0]
    assert all(name in text for name in (*PHASES, WHOLE, "published", *METHODS, *MOTIONS))
