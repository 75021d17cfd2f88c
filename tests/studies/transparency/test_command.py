"""`python -m studies.transparency`: what it writes of what was measured, and what it refuses."""

import json
import math

import numpy as np
import pytest

from studies.transparency import command, study
from studies.transparency.hybrid import Hybrid, Response
from studies.transparency.stiffness import SpringContact
from studies.transparency.study import HANDS, Case, Study, Task, Walls
from studies.transparency.zwidth import Width
from teleop.cli import commands


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


@pytest.fixture
def measured(monkeypatch):
    def run(commanded, _workers):
        return [case(commanded, n, d) for n in commanded.couplings for d in commanded.round_trips]

    monkeypatch.setattr(command, "run_study", run)


def bench(*words):
    return commands.run_program("python -m studies.transparency", command, list(map(str, words)))


@pytest.mark.usefixtures("measured")
def test_it_writes_tables_and_numbers(tmp_path, capsys):
    words = ["--couplings", "direct", "wave", "--round-trips", 0, 100]
    assert bench(*words, "--out", tmp_path / "out") == 0
    told = capsys.readouterr()
    assert "wave" in told.out
    assert "does not apply" in told.out
    text = (tmp_path / "out" / "transparency.md").read_text()
    assert text.count("\n## ") == 3
    assert "≥ 10000" in text
    assert "< 100" in text
    assert "0.50, 2.0 %" in text  # coherence and distortion
    numbers = json.loads(
        (tmp_path / "out" / "transparency.json").read_text(), parse_constant=pytest.fail
    )
    assert numbers["settings"]["round_trips"] == [0.0, 0.1]
    assert len(numbers["cases"]) == 4
    told = {(c["coupling"], c["round_trip"]): c for c in numbers["cases"]}
    assert told["wave", 0.0]["z_width"][0]["unstable"] is None
    assert told["wave", 0.0]["llewellyn"] is None
    assert told["direct", 0.1]["llewellyn"]["stable"] == [False] * 9  # Re h22 < 0


@pytest.mark.usefixtures("measured")
def test_over_a_bad_network_llewellyn_does_not_apply(tmp_path, capsys):
    words = ["--couplings", "direct", "--jitter", 20, "--loss", 0.1, "--round-trips", 100]
    assert bench(*words, "--encoder", 50, "--out", tmp_path) == 0
    assert "does not apply" in capsys.readouterr().out
    numbers = json.loads((tmp_path / "transparency.json").read_text())
    assert numbers["settings"]["device"]["resolution"] == pytest.approx(50e-6)
    assert numbers["cases"][0]["llewellyn"] is None


@pytest.mark.parametrize(
    "words",
    [
        ["--couplings", "magic"],
        ["--round-trips", "20", "1000"],
        ["--jitter", "500"],
        ["--out", __file__],
    ],
)
def test_what_makes_no_sense_is_refused_in_a_line(words, capsys):
    assert bench(*words) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert len(told.err.splitlines()) == 1
    assert words[0] in told.err


def test_a_measurement_runs_the_live_loops():
    commanded = Study(cap=200.0, lowest=200.0)
    found = study.measure_task(commanded, Task("zwidth", "direct", 0.0, "firm", 5.0))
    assert found.width == Width(200.0, math.inf)
    assert 0.0 < found.buzz < 0.05
