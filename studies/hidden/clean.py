"""Count false alarms on clean records: two makers, travel noise, rates, benches, seeds.

    python -m studies.hidden.clean --seeds 1 2 3

A false alarm is any verdict but "clean". Whether K lies in its interval is counted too.
"""

import argparse
import itertools
import time
from multiprocessing import get_context
from typing import NamedTuple

from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.measured_data import prepare_record
from estimator.diagnosis.outcome import Verdict
from studies import hidden
from studies.hidden.play_grid import make_grid

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
        made = hidden.make(
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
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--noise", type=float, nargs="+", default=NOISES, help="[m]")
    parser.add_argument("--rates", type=float, nargs="+", default=RATES, help="[Hz]")
    parser.add_argument("--makers", nargs="+", default=MAKERS, choices=MAKERS)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    cases = [
        Case(*one)
        for one in itertools.product(args.makers, args.seeds, args.rates, args.noise, BENCHES)
    ]
    results = []
    with get_context("spawn").Pool(args.jobs) as pool:
        for one in pool.imap_unordered(judge, cases):
            results.append(one)
            print(
                "right" if one.right else "WRONG",
                *one.case,
                one.verdict,
                "+".join(one.causes),
                f"K {one.K:.4f} {'in' if one.inside else 'NOT in'} {one.low:.4f}..{one.high:.4f}",
                f"{one.seconds:.1f} s",
                flush=True,
            )
    for maker in args.makers:
        of = [one for one in results if one.case.maker == maker]
        print(
            f"{maker}: {sum(not one.right for one in of)} false alarms in {len(of)}, "
            f"K inside its interval in {sum(one.inside for one in of)}"
        )


if __name__ == "__main__":
    main()
