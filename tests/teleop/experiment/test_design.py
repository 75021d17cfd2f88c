"""Designs: balance by counting, convergence by brute force, trials that answers determine."""

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from teleop.errors import UsageError
from teleop.experiment.design import (
    BayesianAdaptive,
    ConstantStimuli,
    Design,
    Staircase,
    build_latin_square,
)
from teleop.experiment.psychometric import compute_probability

QUEST = BayesianAdaptive(
    np.linspace(0, 100, 41), np.linspace(5, 95, 31), np.geomspace(3, 60, 8), 30
)
STAIRCASE = Staircase(80.0, (16, 8, 4), 0.0, 100.0)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 7, 10])
def test_each_condition_is_everywhere_and_follows_each_other_equally_often(count):
    square = build_latin_square(count)
    assert len(square) == (count if count % 2 == 0 or count == 1 else 2 * count)
    assert all(sorted(row) == list(range(count)) for row in square)
    for column in zip(*square, strict=True):
        assert set(Counter(column).values()) == {len(square) // count}
    pairs = Counter(pair for row in square for pair in pairwise(row))
    assert len(pairs) == count * (count - 1)
    assert len(set(pairs.values())) <= 1


def test_participants_meet_all_combinations_in_balanced_orders():
    design = Design(factors={"a": (1, 2), "b": ("x", "y", "z")}, repetitions=2, seed=3)
    orders = [design.order_conditions(number) for number in (1, 2, 3)]
    firsts = Counter(tuple(order[at].values()) for order in orders for at in (0, 6))
    assert len(firsts) == 6
    assert all(count == 1 for count in firsts.values())
    other = Design(factors=design.factors, repetitions=2, seed=4)
    assert other.order_conditions(1) != orders[0]


def test_constant_stimuli_come_in_random_blocks_of_all_levels():
    procedure, seen = ConstantStimuli((1.0, 2.0, 5.0), 40, seed=1), []
    while not procedure.is_done:
        seen.append(procedure.choose_stimulus())
        procedure.record(True)
    blocks = np.reshape(seen, (40, 3))
    assert np.all(np.sort(blocks) == [1.0, 2.0, 5.0])
    assert len({tuple(block) for block in blocks}) == 6


def test_a_staircase_converges_where_707_in_1000_answers_are_correct():
    rng = np.random.default_rng(1)
    staircase = Staircase(60.0, (0.5,), 0.0, 100.0, reversals=10**9, trials_max=20_000)
    chances = []
    while not staircase.is_done:
        chance = float(compute_probability(staircase.choose_stimulus(), 40.0, 10.0, 0.5))
        chances.append(chance)
        staircase.record(rng.random() < chance)
    assert np.mean(chances[1000:]) == pytest.approx(0.5**0.5, abs=0.006)


def test_a_staircase_ends_by_its_reversals_within_its_bounds():
    staircase, seen = Staircase(5.0, (4.0, 2.0), 0.0, 10.0, reversals=4), []
    for correct in (True, True, False, True, True, True, True, False):
        assert not staircase.is_done
        seen.append(staircase.choose_stimulus())
        staircase.record(correct)
    assert seen == [5.0, 5.0, 1.0, 3.0, 3.0, 1.0, 1.0, 0.0]
    staircase.record(True)
    staircase.record(True)
    assert staircase.is_done


def test_the_chosen_stimulus_is_that_of_the_least_expected_entropy():
    """By brute force, from the definition, over the posterior after some answers."""
    stimuli, thresholds, spreads = (0.0, 30.0, 60.0), (10.0, 30.0, 50.0), (5.0, 20.0)
    adaptive = BayesianAdaptive(stimuli, thresholds, spreads, 9, lapse_rates=(0.02,))
    cases = [(a, b) for a in thresholds for b in spreads]
    posterior = np.full(6, 1 / 6)
    for correct in (True, False, True, True, False):
        expected = []
        for x in stimuli:
            p = np.array([compute_probability(x, a, b, 0.5, 0.02) for a, b in cases])
            entropy = 0.0
            for chance in (p, 1.0 - p):
                after = posterior * chance
                after, total = after / after.sum(), after.sum()
                entropy -= total * (after * np.log(after)).sum()
            expected.append(entropy)
        assert adaptive.choose_stimulus() == stimuli[int(np.argmin(expected))]
        p = np.array(
            [compute_probability(adaptive.choose_stimulus(), a, b, 0.5, 0.02) for a, b in cases]
        )
        posterior = posterior * (p if correct else 1.0 - p)
        posterior /= posterior.sum()
        adaptive.record(correct)


@pytest.mark.parametrize("procedure", [ConstantStimuli((1.0, 2.0), 5), STAIRCASE, QUEST, None])
def test_the_same_answers_give_the_same_trials(procedure):
    intervals = 1 if procedure is None else 2
    design = Design(factors={"a": (1, 2)}, procedure=procedure, intervals=intervals)
    rng, trials, answers = np.random.default_rng(5), [], []
    sequence = design.begin(3)
    while not sequence.is_done:
        trials.append(sequence.choose_trial())
        assert sequence.choose_trial() == trials[-1]
        answers.append(str(rng.integers(2) + 1))
        sequence.record(answers[-1])
    again = design.begin(3)
    for trial, answer in zip(trials, answers, strict=True):
        assert again.choose_trial() == trial
        again.record(answer)
    assert again.is_done
    assert [trial.number for trial in trials] == list(range(1, len(trials) + 1))
    assert {trial.block for trial in trials} == {1, 2}


def test_answers_are_judged_by_the_interval_that_had_the_stimulus():
    sequence = Design(procedure=ConstantStimuli((1.0,), 50), intervals=3).begin(1)
    targets = set()
    while not sequence.is_done:
        target = sequence.choose_trial().target
        targets.add(target)
        assert sequence.judge(str(target % 3 + 1)) is False
        with pytest.raises(UsageError, match="allowed are 1, 2, 3"):
            sequence.judge("4")
        assert sequence.record(str(target)) is True
    assert targets == {1, 2, 3}


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ({"procedure": QUEST}, "guess_rate 0.5: is 0 with 1 intervals"),
        ({"factors": {"a": (1, 1)}}, "factors: each needs levels"),
        ({"intervals": 2}, "more than one needs a procedure"),
    ],
)
def test_a_design_that_cannot_be_is_refused(words, line):
    with pytest.raises(UsageError, match=line):
        Design(**words)
