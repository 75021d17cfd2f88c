"""What docs/how-to/diagnose.md shows is so."""

import re
from pathlib import Path

import pytest

from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.record import prepare_record
from estimator.effects import Effect
from studies import hidden_effects
from teleop.cli.diagnose.diagnosis_run import parse_effects

DOCS = Path(__file__).parents[4] / "docs"
PAGE = DOCS / "how-to" / "diagnose.md"


def block():
    (text,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.M | re.S)
    return text


def test_pictures_of_the_page_are_there():
    pictures = re.findall(r"\]\(\.\./(images/.*?)\)", PAGE.read_text())
    assert pictures
    assert all((DOCS / picture).is_file() for picture in pictures)


@pytest.mark.slow
def test_the_effect_of_the_page_is_found_among_others():
    names = {}
    exec(block(), names)  # noqa: S102 - our own page
    (effect,) = (one for one in names.values() if isinstance(one, Effect))
    data = hidden_effects.make(5, (), bench="spring", duration=16.0, rate=50.0)
    T = data.channels["distal_tension"]
    record = prepare_record(data.time, data.channels | {"distal_tension": T + 0.006 * T**2})
    found = diagnose_records(
        [record], [*parse_effects("distal_tension_gain,constant_drag"), effect]
    )
    assert (found.verdict, found.causes) == (Verdict.NAMED, (effect.name,))
    assert found.parameters[f"{effect.name}.curve"].value == pytest.approx(0.006, rel=0.1)
