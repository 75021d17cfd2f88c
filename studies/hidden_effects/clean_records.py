"""Count false alarms on clean records: two makers, travel noise, rates, benches, seeds.

    python -m studies.hidden_effects.clean_records --seeds 1 2 3

A false alarm is any verdict but "clean". Whether K lies in its interval is counted too. 80 records
a seed, each 4 s of a processor at 50 Hz and more above: 10 minutes a seed.
"""

import itertools
import time
from typing import NamedTuple

from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.record import prepare_record
from studies import hidden_effects
from studies.hidden_effects.play_grid import make_grid
from studies.testbed.command import parse_options
from studies.testbed.parallel import map_in_parallel
from teleop.runtime.machine import count_processors

RATES = (50.0, 100.0, 500.0, 1000.0)
NOISES = (0.0, 1e-7, 5e-7, 1e-6, 5e-6)  # [m]
BENCHES = ("blocked", "spring")
MAKERS = ("chain", "grid")


class Case(NamedTuple):
    """One clean record to be made and diagnosed."""

    maker: str
    seed: int
    rate: float
    noise: float
    bench: str


class Result(NamedTuple):
    """What came of it."""

    case: Case
    verdict: str
    causes: tuple[str, ...]
    K: float
    low: float
    high: float
    seconds: float  # of one processor

    @property
    def right(self):
        """Whether nothing was found."""
        return self.verdict == Verdict.CLEAN

    @property
    def inside(self):
        """Whether K is in its interval."""
        return self.low <= self.K <= self.high


def judge(case):
    """Make a record, diagnose it, and return what came of it."""
    if case.maker == "grid":
        made = make_grid(case.seed, case.bench, rate=case.rate, travel_noise=case.noise)
        K = made.K
    else:
        made = hidden_effects.make(
            1000 + case.seed, (), bench=case.bench, rate=case.rate, travel_noise=case.noise
        )
        K = made.truth["sheath"]["K"]
    began = time.process_time()
    found = diagnose_records([prepare_record(made.time, dict(made.channels))])
    seconds = time.process_time() - began
    number = found.parameters["K"]
    return Result(
        case, str(found.verdict), found.causes, K, float(number.low), float(number.high), seconds
    )


def main():
    """Run all cases and print what came of them."""
    args = parse_options(
        __doc__,
        seeds=((1,), "of the records"),
        noise=(NOISES, "white, on both travels [m]"),
        rates=(RATES, "of the records [Hz]"),
        makers=(MAKERS, "of the records"),
        jobs=(count_processors(), "processes"),
    )
    varied = itertools.product(args.makers, args.seeds, args.rates, args.noise, BENCHES)
    results = []
    for result in map_in_parallel(judge, list(itertools.starmap(Case, varied)), args.jobs):
        results.append(result)
        inside = "in" if result.inside else "NOT in"
        print(
            "right" if result.right else "WRONG", *result.case, result.verdict,
            "+".join(result.causes),
            f"K {result.K:.4f} {inside} {result.low:.4f}..{result.high:.4f}",
            f"{result.seconds:.1f} s", flush=True,
        )  # fmt: skip
    for maker in args.makers:
        made = [result for result in results if result.case.maker == maker]
        print(
            f"{maker}: {sum(not result.right for result in made)} false alarms in {len(made)}, "
            f"K inside its interval in {sum(result.inside for result in made)}"
        )


if __name__ == "__main__":
    main()
