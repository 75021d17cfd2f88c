"""Two travels without a tension: what reversals lose of a rich plant, and what that determines."""

import numpy as np
import pytest

from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.record import RecordError
from estimator.diagnosis.travel_diagnosis import diagnose_travels
from estimator.measured_data import Samples
from studies import hidden_effects
from teleop.cli import commands
from teleop.data.measured_table import write_table

RNG = np.random.default_rng(3)
TIME = np.arange(1500) * 0.02
TRAVEL = np.interp(TIME, np.linspace(0.0, 30.0, 25), RNG.uniform(0.0, 5e-3, 25))


def pair(q_p, q_d, noise=2e-6, time=TIME):
    q_d = q_d + noise * RNG.standard_normal(len(q_d))
    return Samples(time, np.full(len(time), np.nan), q_p, None, q_d)


def bench(effects=()):
    made = hidden_effects.make(
        6, effects, bench="spring", duration=30.0, rate=50.0, travel_noise=2e-6
    )
    q_p, q_d = (made.channels[f"{end}_displacement"] for end in ("proximal", "distal"))
    return made.truth["sheath"], pair(q_p, q_d, 0.0, made.time)


def after_play(travel, half_width):
    out = [travel[0]]
    for u in travel[1:]:
        out.append(min(max(out[-1], u - half_width), u + half_width))
    return np.array(out)


def test_friction_of_a_sheath_against_a_spring_is_told_from_backlash():
    sheath, data = bench()
    found = diagnose_travels([data])
    assert found.verdict is Verdict.CHARACTERISED
    assert [stage.name for stage in found.stages] == ["line", "play", "widening_play"]
    assert found.friction == pytest.approx(sheath["K"], rel=0.03)
    stretch = sheath["L"] / sheath["EA"] * sheath["k"]
    assert found.stretch == pytest.approx(stretch, rel=0.03)
    assert found.lost.high < 0.01 * found.lost_loaded.value  # no backlash
    assert found.missed_share < 0.01


@pytest.mark.parametrize("extra", ["drift", "lag"])
def test_backlash_is_found_with_what_is_beside_it_and_no_friction_is_invented(extra):
    tip = 0.8 * after_play(TRAVEL, 2e-4)
    if extra == "drift":
        tip = tip + 4e-4 * TIME / TIME[-1]
    if extra == "lag":
        tip = tip - 0.02 * np.gradient(TRAVEL, TIME)
    found = diagnose_travels([pair(TRAVEL, tip)])
    assert [stage.name for stage in found.stages] == ["line", "play", extra]
    assert found.lost.low < 4e-4 < found.lost.high or found.lost.value == pytest.approx(
        4e-4, rel=0.03
    )
    assert found.gain == pytest.approx(0.8, rel=0.01)
    assert np.isnan(found.friction)


def test_a_straight_line_is_clean_and_an_unrelated_tip_is_no_tendon():
    assert diagnose_travels([pair(TRAVEL, 0.7 * TRAVEL)]).verdict is Verdict.CLEAN
    other = np.interp(TIME, np.linspace(0.0, 30.0, 31), RNG.uniform(0.0, 5e-3, 31))
    found = diagnose_travels([pair(TRAVEL, other)])
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.missed_share > 0.5


def test_only_what_says_nothing_is_refused():
    with pytest.raises(RecordError, match="never changes"):
        diagnose_travels([pair(0.0 * TRAVEL, TRAVEL)])
    pieces = np.concatenate([TRAVEL[k : k + 40] for k in RNG.integers(0, 1400, 36)])
    with pytest.raises(RecordError, match=r"jumps \d+ times"):
        diagnose_travels([pair(pieces, pieces, time=TIME[: len(pieces)])])


def test_the_command_reads_two_travels_and_says_what_they_do_not_tell(tmp_path, capsys):
    _, data = bench()
    path = tmp_path / "travels.csv"
    columns = {"time_s": data.time, "proximal_displacement_m": data.proximal_displacement}
    write_table(path, columns | {"distal_displacement_m": data.distal_displacement})
    assert commands.main(["diagnose", str(path), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert said.startswith("Each reversal takes motor travel that grows with the load")
    assert "Not determined by travel at the housing and travel at the tip alone" in said
    assert (tmp_path / "out" / "report.html").exists()
    assert not (tmp_path / "out" / "model.yaml").exists()
    assert commands.main(["diagnose", str(path), "--fit-all"]) == 2
    assert "--fit-all: needs a tension" in capsys.readouterr().err
    write_table(path, columns | {"distal_displacement_m": columns["time_s"], "load_cell": TIME})
    assert commands.main(["diagnose", str(path)]) == 2  # a tension of another name is asked for
    assert "proximal_tension=" in capsys.readouterr().err
