"""The diagnosis of a measured bench: a session with two load cells, and no travel."""

import numpy as np
import pytest

from estimator.diagnosis import report_text
from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.record import prepare_record

PLAIN = 0.467  # [N] that the symmetric law leaves, fitted to all of it

pytestmark = [pytest.mark.measured, pytest.mark.slow]


@pytest.fixture(scope="module")
def found(measured_data):
    session = measured_data / "sheath-bench" / "session1.csv"
    table = np.genfromtxt(session, delimiter=",", names=True)
    signals = {name: table[f"{name}_N"] for name in ("proximal_tension", "distal_tension")}
    return diagnose_records([prepare_record(table["time_s"], signals)], workers=2)


def test_what_removes_most_of_the_error_is_found_with_its_look_alikes(found):
    assert found.verdict is Verdict.AMBIGUOUS
    assert {*found.causes, *found.ambiguous_with} == {
        "distal_tension_gain",
        "proximal_tension_gain",
        "direction_asymmetry",
    }
    assert found.after.fit["distal_tension"].rmse < 0.185 < 0.4 * PLAIN


def test_what_it_is_worth_on_held_out_blocks_is_what_it_is_worth_where_it_was_fitted(found):
    before, after = (
        [one.fit["distal_tension"].rmse, one.held_out["distal_tension"].rmse]
        for one in (found.before, found.after)
    )
    fitted, held_out = (1.0 - b / a for a, b in zip(before, after, strict=True))
    assert held_out == pytest.approx(fitted, rel=0.1)


def test_the_experiments_that_would_tell_them_apart_and_what_is_left_are_said(found):
    assert any("known weight" in what for what in found.experiments)
    (left,) = report_text.describe_residuals(found)
    assert "0.18" in left
    assert "noise is 0.0" in left
