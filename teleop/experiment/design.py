"""Designs of experiments: which condition and stimulus comes next, given the answers so far.

Nothing here knows a clock or a session: the same design and the same answers give the same trials,
which is how an interrupted experiment goes on.
"""

import dataclasses
import itertools
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import numpy as np
from scipy import special

from estimator.array_types import Array
from teleop.errors import UsageError
from teleop.experiment.psychometric import Shape, compute_probability

Value = float | int | str | bool  # of a factor


# --- order of conditions


def build_latin_square(count: int) -> list[list[int]]:
    """Return a balanced Latin square: in which order each row's participant meets conditions.

    Each condition is once at each place of a row set of `count`, and each follows each other
    condition equally often: `count` rows for an even number of conditions, twice as many for an odd
    one. Williams, "Experimental designs balanced for the estimation of residual effects of
    treatments", Australian Journal of Scientific Research A 2 (1949) 149-168.
    """
    zigzag = [(place + 1) // 2 if place % 2 else -(place // 2) for place in range(count)]
    rows = [[(first + shift) % count for shift in zigzag] for first in range(count)]
    return rows + [row[::-1] for row in rows] if count % 2 and count > 1 else rows


# --- procedures: which stimulus comes next


class Procedure(ABC):
    """Chooses stimuli, of which larger ones are easier; its state is what was recorded.

    A subclass is a dataclass: its parameters are compared when an experiment goes on.
    """

    @property
    @abstractmethod
    def is_done(self) -> bool:
        """Whether there is no further trial."""

    @property
    @abstractmethod
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest stimulus that it may choose."""

    @abstractmethod
    def choose_stimulus(self) -> float:
        """Return the stimulus of the next trial; the same until `record` is called."""

    @abstractmethod
    def record(self, correct: bool) -> None:
        """Take the answer to the stimulus of `next`."""

    def restart(self, seed: int) -> Self:  # noqa: ARG002 - most procedures draw nothing
        """Return the procedure before its first trial, with its own random numbers."""
        return dataclasses.replace(self)  # type: ignore[type-var]


@dataclass
class ConstantStimuli(Procedure):
    """The method of constant stimuli: blocks of all levels, each block in random order."""

    levels: Sequence[float]
    repetitions: int  # blocks
    seed: int = 0

    def __post_init__(self) -> None:
        """Draw the order."""
        _require(len(self.levels) >= 1 and self.repetitions >= 1, "levels, repetitions: 1 or more")
        rng = np.random.default_rng(self.seed)
        blocks = (rng.permutation(np.asarray(self.levels, float)) for _ in range(self.repetitions))
        self._order = [float(level) for block in blocks for level in block]
        self._count = 0

    @property
    def is_done(self) -> bool:
        """Whether each level was repeated as often as asked for."""
        return self._count == len(self._order)

    @property
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest level."""
        return float(min(self.levels)), float(max(self.levels))

    def choose_stimulus(self) -> float:
        """Return the next level."""
        return self._order[self._count]

    def record(self, correct: bool) -> None:  # noqa: ARG002 - the order does not depend on it
        """Count the trial."""
        self._count += 1

    def restart(self, seed: int) -> Self:
        """Return it before its first trial, with an order of its own."""
        return dataclasses.replace(self, seed=seed)


@dataclass
class Staircase(Procedure):
    """Down after two correct answers in a row, up after a wrong one: converges at 70.7 % correct.

    Steps are equal in both directions, so the stimulus settles where p^2 = 1/2. Levitt,
    "Transformed up-down methods in psychoacoustics", J. Acoust. Soc. Am. 49 (1971) 467-477.
    """

    start: float
    steps: Sequence[float]  # the step after 0, 1, 2, ... reversals; the last one is kept
    low: float  # bounds of the stimulus
    high: float
    reversals: int = 12  # after which it ends
    trials_max: int = 200  # after which it ends in any case

    def __post_init__(self) -> None:
        """Check the values, and begin."""
        _require(self.low <= self.start <= self.high, "start: must be from low to high")
        _require(len(self.steps) >= 1 and min(self.steps) > 0.0, "steps: must be above 0")
        _require(self.reversals >= 1 and self.trials_max >= 1, "reversals, trials_max: 1 or more")
        self._stimulus = float(self.start)
        self._run = self._direction = self._reversals = self._count = 0

    @property
    def is_done(self) -> bool:
        """Whether it has reversed as often as asked for."""
        return self._reversals >= self.reversals or self._count >= self.trials_max

    @property
    def bounds(self) -> tuple[float, float]:
        """The bounds that it is given."""
        return float(self.low), float(self.high)

    def choose_stimulus(self) -> float:
        """Return the stimulus where it stands."""
        return self._stimulus

    def record(self, correct: bool) -> None:
        """Take an answer, and step after a wrong one or the second correct one."""
        self._count += 1
        self._run = self._run + 1 if correct else 0
        if correct and self._run < 2:
            return
        self._run, direction = 0, -1 if correct else 1
        if direction == -self._direction:
            self._reversals += 1
        self._direction = direction
        step = self.steps[min(self._reversals, len(self.steps) - 1)]
        stimulus = round(self._stimulus + direction * step, 12)  # a level has one number
        self._stimulus = float(min(max(stimulus, self.low), self.high))


@dataclass
class BayesianAdaptive(Procedure):
    """The stimulus whose answer is expected to tell most of threshold, spread and lapse rate.

    The posterior is kept on a grid, and the next stimulus is that of the least expected entropy of
    the posterior after its answer. Watson, "QUEST+: A general multidimensional Bayesian adaptive
    psychometric method", Journal of Vision 17 (2017) 3:10.
    """

    stimuli: Sequence[float]  # to choose from
    thresholds: Sequence[float]  # grids of the parameters; the prior is uniform on them
    spreads: Sequence[float]
    trials: int
    guess_rate: float = 0.5
    lapse_rates: Sequence[float] = (0.0, 0.02, 0.04)
    shape: Shape = "normal"

    def __post_init__(self) -> None:
        """Check the values, and tabulate the probabilities."""
        grids = (self.stimuli, self.thresholds, self.spreads, self.lapse_rates)
        _require(min(map(len, grids)) >= 1
                 and min(self.spreads) > 0.0 and self.trials >= 1,
                 "stimuli, thresholds, lapse_rates, trials: 1 or more; spreads > 0")  # fmt: skip
        parameters = np.meshgrid(*grids[1:], indexing="ij")
        threshold, spread, lapse_rate = (np.ravel(grid) for grid in parameters)
        p = compute_probability(np.asarray(self.stimuli, float)[:, None], threshold, spread,
                                self.guess_rate, lapse_rate, self.shape)  # fmt: skip
        p = np.clip(p, 1e-9, 1.0 - 1e-9)  # no answer is impossible
        self._likelihood = np.stack((1.0 - p, p))  # (answers, stimuli, parameters)
        self._x_log_x = special.xlogy(self._likelihood, self._likelihood)
        self._posterior: Array = np.full(len(threshold), 1.0 / len(threshold))
        self._index, self._count = self._choose(), 0

    @property
    def is_done(self) -> bool:
        """Whether all trials were recorded."""
        return self._count == self.trials

    @property
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest stimulus."""
        return float(min(self.stimuli)), float(max(self.stimuli))

    def choose_stimulus(self) -> float:
        """Return the most informative stimulus."""
        return float(self.stimuli[self._index])

    def record(self, correct: bool) -> None:
        """Take an answer into the posterior."""
        posterior = self._posterior * self._likelihood[int(correct), self._index]
        self._posterior = posterior / posterior.sum()
        self._index, self._count = self._choose(), self._count + 1

    def _choose(self) -> int:
        """Return the stimulus with the least expected entropy.

        With answer r, parameters t and posterior w: the sum over r and t of -w p log(w p / P_r),
        where P_r = sum_t w p, is expanded so that only products with tables remain.
        """
        w = self._posterior
        answer = self._likelihood @ w
        joint = self._x_log_x @ w + self._likelihood @ special.xlogy(w, w)
        return int(np.argmin((special.xlogy(answer, answer) - joint).sum(0)))


# --- the whole design


class Trial(NamedTuple):
    """One trial; a participant's numbers begin at 1."""

    number: int
    block: int
    condition: dict[str, Value]
    stimulus: float | None  # of the procedure; None without one
    target: int  # interval that has the stimulus, from 1; the others have the standard


@dataclass(frozen=True, kw_only=True)
class Design:
    """Blocks of conditions, and trials in each.

    The conditions are all combinations of the factors' levels. Participants meet them in the orders
    of a balanced Latin square, participant by participant. In each condition the procedure runs
    once; without a procedure each condition is one trial, of any answer.
    """

    factors: Mapping[str, Sequence[Value]] = field(default_factory=dict)
    procedure: Procedure | None = None
    intervals: int = 1  # of a trial, one of which has the stimulus; 1 asks for yes or no
    repetitions: int = 1  # of all conditions, in further orders of the square
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the values; raises `UsageError`."""
        _require(all(hasattr(v, "__len__") and not isinstance(v, str) for v in
                     self.factors.values()), "factors: each needs a list of levels")  # fmt: skip
        factors = {name: [v.item() if isinstance(v, np.generic) else v for v in levels]
                   for name, levels in self.factors.items()}  # fmt: skip
        object.__setattr__(self, "factors", factors)
        _require(all(len(set(v)) == len(v) > 0 for v in factors.values()),
                 "factors: each needs levels, all different")  # fmt: skip
        _require(self.repetitions >= 1, "repetitions: 1 or more")
        _require(1 <= self.intervals <= 9, "intervals: must be 1 to 9")
        _require(self.intervals == 1 or self.procedure is not None,
                 "intervals: more than one needs a procedure")  # fmt: skip
        guess_rate = getattr(self.procedure, "guess_rate", self.guess_rate)
        _require(abs(guess_rate - self.guess_rate) < 1e-9,
                 f"guess_rate {guess_rate:g}: is {self.guess_rate:g} with {self.intervals} "
                 "intervals")  # fmt: skip

    @property
    def guess_rate(self) -> float:
        """Probability of a correct answer by guessing."""
        return 1.0 / self.intervals if self.intervals > 1 else 0.0

    @property
    def answers(self) -> tuple[str, ...]:
        """Allowed answers: the interval, "yes" or "no", or (empty) any."""
        if self.procedure is None:
            return ()
        if self.intervals == 1:
            return ("yes", "no")
        return tuple(str(number + 1) for number in range(self.intervals))

    @property
    def conditions(self) -> list[dict[str, Value]]:
        """All combinations of the factors' levels, in the order of the factors."""
        return [
            dict(zip(self.factors, levels, strict=True))
            for levels in itertools.product(*self.factors.values())
        ]

    def order_conditions(self, participant: int) -> list[dict[str, Value]]:
        """Return the conditions in the order of a participant, of number 1, 2, ..."""
        conditions = self.conditions
        square = build_latin_square(len(conditions))
        names = np.random.default_rng(self.seed).permutation(len(conditions))
        first = (participant - 1) * self.repetitions
        rows = (square[(first + block) % len(square)] for block in range(self.repetitions))
        return [conditions[names[index]] for row in rows for index in row]

    def describe(self) -> dict[str, Any]:
        """Return all parameters as plain data, to tell a changed design."""
        description: dict[str, Any] = {
            "factors": {name: list(levels) for name, levels in self.factors.items()},
            "intervals": self.intervals,
            "repetitions": self.repetitions,
            "seed": self.seed,
            "procedure": None,
        }
        if (procedure := self.procedure) is not None:
            values = {
                each.name: getattr(procedure, each.name)
                for each in dataclasses.fields(procedure)  # type: ignore[arg-type]
            }
            settings = {
                k: v if isinstance(v, str) else np.asarray(v).tolist() for k, v in values.items()
            }
            description["procedure"] = {"type": type(procedure).__name__, **settings}
        return description

    def begin(self, participant: int) -> "TrialSequence":
        """Return the trials of a participant.

        Raises
        ------
        UsageError
            The number is below 1.
        """
        _require(participant >= 1, f"participant {participant}: numbers begin at 1")
        return TrialSequence(self, participant)


class TrialSequence:
    """All trials of a participant, one after the other; see `Design.begin`."""

    def __init__(self, design: Design, participant: int) -> None:
        self._design = design
        self._order = design.order_conditions(participant)
        self._rng = np.random.default_rng((design.seed, participant))
        self._block = self._number = 0
        self._procedure = self._start_procedure()
        self._target = self._draw_target()

    @property
    def is_done(self) -> bool:
        """Whether there is no further trial."""
        return self._block == len(self._order)

    def choose_trial(self) -> Trial:
        """Return the next trial; the same until `record` is called."""
        stimulus = None if self._procedure is None else self._procedure.choose_stimulus()
        condition = self._order[self._block]
        return Trial(self._number + 1, self._block + 1, condition, stimulus, self._target)

    def judge(self, response: str) -> bool | None:
        """Return whether a response to the next trial is correct; None if any is.

        Raises
        ------
        UsageError
            It is none of the allowed answers, or not one line.
        """
        answers = self._design.answers
        if not answers:
            _require(response.isprintable(), f"response {response[:20]!r}: must be one line")
            return None
        _require(response in answers,
                 f"response {response[:20]!r}: allowed are {', '.join(answers)}")  # fmt: skip
        return response == ("yes" if self._design.intervals == 1 else str(self._target))

    def record(self, response: str) -> bool | None:
        """Take the response to the trial of `next`; return whether it is correct, as `judge`."""
        correct = self.judge(response)
        self._number += 1
        if self._procedure is not None:
            self._procedure.record(bool(correct))
        if self._procedure is None or self._procedure.is_done:
            self._block += 1
            self._procedure = self._start_procedure()
        self._target = self._draw_target()
        return correct

    def _start_procedure(self) -> Procedure | None:
        procedure = self._design.procedure
        return None if procedure is None else procedure.restart(int(self._rng.integers(2**31)))

    def _draw_target(self) -> int:
        return int(self._rng.integers(self._design.intervals)) + 1


def _require(holds: bool, line: str) -> None:
    if not holds:
        raise UsageError(line)
