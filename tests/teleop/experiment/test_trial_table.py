"""Tables of trials: nothing is lost at a crash, and the same experiment goes on."""

import random

import pytest

from teleop import (
    ConstantStimuli,
    Design,
    Experiment,
    Staircase,
    UsageError,
    read_trials,
    run_experiment,
)

DESIGN = Design(
    factors={"delay": (0.0, 0.05), "grip": ("firm, hard", "soft")},
    procedure=Staircase(0.5, (0.1, 0.05), 0.0, 1.0, reversals=3),
    intervals=2,
)
EXPERIMENT = Experiment(name="test", design=DESIGN)
TIMES = {"response_time_s", "begin_stamp_ns", "time"}


def answer(trial):
    """Answer in a way of its own, but the same each time."""
    right = random.Random(trial.number).random() < 0.5 + trial.stimulus  # noqa: S311
    return str(trial.target if right else 3 - trial.target)


def run(folder, experiment=EXPERIMENT, observer=answer, participant=2, say=lambda _: None):
    return run_experiment(None, experiment, participant, folder, observer, say=say)


def drop_times(rows):
    return [{name: text for name, text in row.items() if name not in TIMES} for row in rows]


def test_a_table_has_a_row_a_trial_and_all_of_it(tmp_path):
    rows = read_trials(run(tmp_path))
    assert [int(row["trial"]) for row in rows] == list(range(1, len(rows) + 1))
    assert {(row["delay"], row["grip"]) for row in rows} == {
        (delay, grip) for delay in ("0.0", "0.05") for grip in ("firm, hard", "soft")
    }
    for row in rows:
        assert (row["correct"] == "1") == (row["response"] == row["target"])
        assert row["procedure"] == "Staircase"
        assert row["participant"] == "2"
    run(tmp_path, participant=3)
    assert len(read_trials(tmp_path)) > len(rows)


def test_after_a_crash_at_any_byte_the_same_trials_follow(tmp_path):
    path = run(tmp_path / "whole")
    whole, rows = path.read_bytes(), read_trials(path)
    rng = random.Random(1)  # noqa: S311
    for cut in [0, 1, len(whole) - 1, *(rng.randrange(len(whole)) for _ in range(15))]:
        torn = tmp_path / str(cut)
        torn.mkdir()
        (torn / "design.json").write_bytes((tmp_path / "whole" / "design.json").read_bytes())
        (torn / path.name).write_bytes(whole[:cut] + b"\0" * (cut % 3))
        asked = []
        run(torn, observer=lambda trial: asked.append(trial.number) or answer(trial))  # noqa: B023
        complete = max(whole[:cut].count(b"\n") - 1, 0)
        assert asked == list(range(complete + 1, len(rows) + 1))
        assert drop_times(read_trials(torn)) == drop_times(rows)


def test_an_interrupted_experiment_has_all_answers_on_the_disk(tmp_path):
    seen = []

    def leave(trial):
        if trial.number == 6:
            seen.extend(read_trials(tmp_path))  # by another program
            raise KeyboardInterrupt
        return answer(trial)

    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, observer=leave)
    assert len(seen) == 5
    assert drop_times(read_trials(run(tmp_path))) == drop_times(read_trials(run(tmp_path / "new")))


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"design": Design(factors=DESIGN.factors, procedure=DESIGN.procedure, intervals=3)},
         r"intervals was 2, is 3; a changed design needs another folder"),
        ({"design": Design(factors=DESIGN.factors, intervals=2,
                           procedure=Staircase(0.5, (0.1, 0.04), 0.0, 1.0, reversals=3))},
         r"procedure.steps was \[0.1, 0.05\], is \[0.1, 0.04\]"),
        ({"duration": 1.0}, r"duration was 3.0, is 1.0"),
    ],
)  # fmt: skip
def test_a_changed_design_is_refused_in_one_line(tmp_path, change, line):
    run(tmp_path)
    before = read_trials(tmp_path)
    words = {"name": "test", "design": DESIGN} | change
    with pytest.raises(UsageError, match=line) as caught:
        run(tmp_path, Experiment(**words))
    assert "\n" not in str(caught.value)
    assert read_trials(tmp_path) == before


def test_a_table_that_was_edited_is_refused_with_its_line(tmp_path):
    path = run(tmp_path)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:3] + lines[4:]))
    with pytest.raises(UsageError, match="line 4: is not the trial that this design gives"):
        run(tmp_path)
    path.write_text("".join([*lines[:3], "1,2\n", *lines[4:]]))
    with pytest.raises(UsageError, match="line 4: has 2 cells"):
        run(tmp_path)


def test_two_programs_do_not_write_one_table(tmp_path):
    def answer_twice(trial):
        with pytest.raises(UsageError, match="another program writes it"):
            run(tmp_path)
        return answer(trial)

    run(tmp_path, Experiment(name="test", design=DESIGN), answer_twice)


def test_an_answer_that_is_none_is_refused_and_not_kept(tmp_path):
    with pytest.raises(UsageError, match="response '3': allowed are 1, 2"):
        run(tmp_path, observer=lambda _: "3")
    assert read_trials(tmp_path) == []


def test_a_condition_may_not_be_named_as_a_column(tmp_path):
    design = Design(factors={"target": (1, 2)}, procedure=ConstantStimuli((1.0,), 1))
    with pytest.raises(UsageError, match="factor 'target'"):
        run(tmp_path, Experiment(name="test", design=design))
