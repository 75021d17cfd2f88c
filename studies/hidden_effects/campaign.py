"""Hide effects, diagnose, count: the confusion matrix of the diagnosis (make bench-diagnosis).

  python -m studies.hidden_effects.campaign --first 4 --seeds 2 --clean 0 --outside 0 --pairs 0

Every effect of the catalogue at two sizes on each bench that has it, clean records, records with
an effect outside the catalogue, and pairs. The diagnosis sees the channels only. A record takes
10 s to some minutes of a processor, the oracle beside it as long again: hours in all.
"""

import itertools
import math
import time
from collections import Counter
from functools import partial
from typing import NamedTuple

import numpy as np

from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.dataset import build_context
from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.record import prepare_record
from estimator.effects import CATALOGUE
from estimator.effects.effect import Effect, Parameter
from studies import hidden_effects
from studies.testbed.command import parse_options
from studies.testbed.parallel import map_in_parallel
from teleop.runtime.machine import count_processors

BENCHES = ("blocked", "spring")
SIZES = (1.0, 0.5)
ALIKE = 3  # causes in a set that is not told apart
ORACLE = 1.15
LEFT = 0.3  # of the error beyond noise, which the true law takes away
ABSORBED = 1.8  # noises: no more than the diagnosis allows noise and a simulation's own error
GAIN = 0.7  # of what the true friction explains, that a function explains
WITHIN = 0.1  # of itself, a number is right
ANGLES = ("sine", "cosine")
_AT_THE_END = {
    "friction_drift": "change",
    "proximal_tension_drift": "drift",
    "distal_tension_drift": "drift",
}
"""Effects whose size is told at the record's end, and found as a rate a minute."""

_RENAMED = {
    ("friction_step", "time"): "onset",
    ("encoder_slip", "time"): "onset",
    ("tip_moved", "time"): "onset",
    ("tip_moved", "travel"): "size",
    ("tip_moved", "ramp"): "duration",
    ("sensor_lag", "lag"): "time",
    ("presliding", "bristle"): "distance",
    ("stick_slip", "excess"): "ratio",
}


class Case(NamedTuple):
    """One record to be made and diagnosed."""

    seed: int
    effects: tuple[str, ...]
    size: float
    bench: str
    duration: float
    rate: float
    travel_noise: float = 0.0  # [m]

    @property
    def outside(self):
        """Whether its effect is none of the catalogue."""
        return any(name in hidden_effects.OUTSIDE for name in self.effects)


class Checked(NamedTuple):
    """A number that was hidden, and as it was found, with its 95 % interval."""

    name: str
    true: float
    found: float
    low: float
    high: float

    @property
    def right(self):
        """Whether it is within 10 %, or inside its interval."""
        return abs(self.found - self.true) <= WITHIN * abs(self.true) or (
            self.low <= self.true <= self.high
        )


class Result(NamedTuple):
    """What came of it."""

    case: Case
    verdict: str
    causes: tuple[str, ...]
    rivals: tuple[str, ...]
    seen: float  # held-out RMSE of the plain law over the noise, of the worst channel
    left: float
    numbers: tuple[Checked, ...]
    oracle: float  # held-out RMSE over that of the true model, fitted; of the worst channel
    seconds: float  # of the processor
    by: str = ""  # the function that is to be found
    inside: float = math.nan  # share of the samples in which its band has the true friction
    forces: tuple[float, float] = (math.nan, math.nan)  # [N] RMSE live, held out, without and with
    gain: float = math.nan  # of held-out errors beyond noise, over that of the true friction

    @property
    def right(self):
        """Whether the verdict is what was asked for."""
        effects = self.case.effects
        if self.by:
            said = (*self.causes, *self.rivals)
            return self.by in said and len(said) <= 2
        if self.case.outside:
            return not self.confident
        if not effects or (self.absorbed and self.verdict == Verdict.CLEAN):
            return self.verdict == Verdict.CLEAN
        named = self.confident
        named_causes = {*self.causes, *self.rivals}
        return (
            named and set(effects) <= named_causes and len(named_causes) <= ALIKE + len(effects) - 1
        )

    @property
    def confident(self):
        """Whether it names a cause of the catalogue."""
        return self.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)

    @property
    def needless(self):
        """Whether it names a cause beside the hidden ones."""
        hidden_ones = set(self.case.effects)
        return bool(set(self.causes) - hidden_ones) and hidden_ones <= {*self.causes, *self.rivals}

    @property
    def absorbed(self):
        """Whether the plain law, fitted, leaves no more than noise of what was hidden."""
        return self.seen < ABSORBED

    @property
    def wrong_name(self):
        """Whether it named something else, and surely."""
        return (
            not self.right
            and (self.verdict == Verdict.NAMED or bool(self.by and self.causes))
            and not set(self.case.effects) & set(self.causes)
        )


def judge(case, among=CATALOGUE, oracle=True):
    """Make a record, diagnose it, and return what came of it, beside an `oracle` if wanted."""
    made = hidden_effects.make(
        case.seed,
        case.effects,
        size=case.size,
        bench=case.bench,
        duration=case.duration,
        rate=case.rate,
        travel_noise=case.travel_noise,
    )
    record = prepare_record(made.time, dict(made.channels), variables=made.variables)
    began = time.process_time()
    found = diagnose_records([record], among)
    seconds = time.process_time() - began
    by = _name_expected_function(case, made.truth)
    has_curve = by.startswith("friction") and by in found.causes
    return Result(
        case,
        str(found.verdict),
        found.causes,
        found.ambiguous_with,
        max(one.rmse / found.noise[c] for c, one in found.before.held_out.items()),
        found.residual_fraction,
        collect_checked_numbers(made, found) if set(found.causes) == set(case.effects) else (),
        _compare_to_oracle(record, found, case.effects) if oracle else math.nan,
        seconds,
        by,
        _measure_band_coverage(made, found) if has_curve else math.nan,
        found.live_error or (math.nan, math.nan),
        _compare_gain_to_truth(made, record, found) if has_curve and oracle else math.nan,
    )


def collect_checked_numbers(made, found):
    """Return the numbers of a hidden bench that a diagnosis also has, under its names."""
    sheath = made.truth["sheath"]
    true = {"K": sheath["K"], "L/EA": sheath["L"] / sheath["EA"]}
    if sheath["k"]:
        true["tip compliance"] = 1.0 / sheath["k"]
    minutes = made.time[-1] / 60.0
    for name, secret in made.truth.items():
        if name != "sheath":
            words = {_RENAMED.get((name, key), key): value for key, value in secret.items()}
            if name in _AT_THE_END:
                words["rate"] = words.pop(_AT_THE_END[name]) / minutes
            true |= {f"{name}.{key}": value for key, value in words.items()}
    numbers = found.parameters
    rows = [
        Checked(name, float(true[name]), number.value, number.low, number.high)
        for name, number in numbers.items()
        if isinstance(true.get(name), float | int)
    ]
    return tuple(rows) + tuple(_check_amplitudes(true, numbers))


def _check_amplitudes(true, numbers):
    """Yield the amplitudes of waves, which are found as a sine and a cosine."""
    for name in (key.removesuffix(".sine") for key in numbers if key.endswith(".sine")):
        if f"{name}.amplitude" in true:
            sine, cosine = (numbers[f"{name}.{key}"] for key in ANGLES)
            size = math.hypot(sine.value, cosine.value)
            spread = math.hypot(sine.high - sine.low, cosine.high - cosine.low) / 2.0
            wanted = float(true[f"{name}.amplitude"])
            yield Checked(f"{name}.amplitude", wanted, size, size - spread, size + spread)


def _measure_band_coverage(made, found):
    """Return the share of samples in which the band of a curve has the true friction.

    A constant factor is the plain law's.
    """
    record, curve = found.dataset.records[0], found.curve
    x = curve.effect.function.evaluate(build_context(record, None, 0.0))
    x = x % curve.period if curve.period else x
    value, width = (np.interp(x, curve.x, y) for y in (curve.value, curve.half_width))
    friction = np.interp(record.start + record.time, made.time, made.friction)
    true = friction * np.median((1.0 + value) / friction) - 1.0
    return float(np.mean(np.abs(true - value) <= width))


def _compare_gain_to_truth(made, record, found):
    """Return the share of the error beyond noise that is explained, over that by true friction."""

    def physics(plain, values, context):
        friction = np.interp(record.start + context.time, made.time, made.friction)
        return plain._replace(friction=plain.friction * (1.0 + values[0] * (friction - 1.0)))

    true = Effect(
        name="true_friction",
        cause="",
        equation="",
        parameters=(Parameter("share", "", 0.0, 2.0, 0.05, 0.0),),
        source="",
        advice="",
        starts=lambda _: [(1.0,)],
        physics=physics,
    )
    left = diagnose_records([record], [true]).residual_fraction
    return (1.0 - found.residual_fraction) / (1.0 - left)


def _name_expected_function(case, truth):
    """Return the name of the function that a case is to end in; empty where it is none."""
    name = next(iter(case.effects), "")
    return hidden_effects.BY.get(name, "").format(**truth.get(name, {}))


def _compare_to_oracle(record, found, effects):
    """Return by how much the held-out errors are larger than with what was hidden, fitted.

    NaN where nothing of the catalogue was hidden.
    """
    if not effects or any(name in hidden_effects.OUTSIDE for name in effects):
        return math.nan
    true = diagnose_records([record], [effect for effect in CATALOGUE if effect.name in effects])
    return max(
        one.rmse / max(true.after.held_out[channel].rmse, found.noise[channel])
        for channel, one in found.after.held_out.items()
    )


def list_cases(seeds, clean, outside, pairs, how, only):
    """Return the cases of a range of seeds; `how` is duration [s], rate [Hz], travel noise [m]."""
    made = [
        Case(seed, (name,), size, bench, *how)
        for seed in seeds
        for name in only
        for size in SIZES
        for bench in hidden_effects.VISIBLE[name]
    ]
    first = seeds.start
    made += [Case(first + k, (), 1.0, BENCHES[k % 2], *how) for k in range(clean)]
    made += [
        Case(seed, (name,), SIZES[seed // 2 % 2], BENCHES[seed % 2], *how)
        for seed, name in itertools.product(range(first, first + outside), hidden_effects.OUTSIDE)
    ]
    rng = np.random.default_rng(0)
    for k in range(pairs):
        names = [
            name for name in hidden_effects.EFFECTS if "spring" in hidden_effects.VISIBLE[name]
        ]
        two = tuple(rng.choice(names, 2, replace=False).tolist())
        made.append(Case(first + k, two, 1.0, "spring", *how))
    return made


def main():
    """Run the campaign and print what came of it."""
    args = parse_options(
        __doc__,
        seeds=(5, "number of seeds for each effect of the catalogue"),
        first=(1, "of the seeds"),
        clean=(100, "number of records without an effect"),
        outside=(5, "number of records with each effect outside the catalogue"),
        pairs=(20, "number of records with two effects"),
        duration=(60.0, "of a record [s]"),
        rate=(100.0, "of a record [Hz]"),
        travel_noise=(0.0, "white, on both travels [m]"),
        jobs=(count_processors(), "processes"),
        only=(tuple(hidden_effects.EFFECTS), "effects of the catalogue"),
        no_oracle=(False, "not the true model, fitted, beside it: in half the time"),
    )
    todo = list_cases(
        range(args.first, args.first + args.seeds),
        args.clean,
        args.outside,
        args.pairs,
        (args.duration, args.rate, args.travel_noise),
        args.only,
    )
    results = []
    for result in map_in_parallel(partial(judge, oracle=not args.no_oracle), todo, args.jobs):
        results.append(result)
        print_result(result)
    print_summary(results)


def print_result(result):
    """Print one line of a result."""
    case = result.case
    print(
        "right" if result.right else "WRONG",
        case.seed,
        "+".join(case.effects) or "clean",
        case.size,
        case.bench,
        "->",
        result.verdict,
        "+".join(result.causes),
        "| " + ", ".join(result.rivals) if result.rivals else "",
        f"plain {result.seen:.1f} noises, left {result.left:.3f}",
        f"{result.oracle:.2f} of the oracle, {result.seconds:.0f} s",
        ""
        if math.isnan(result.inside)
        else f"{result.inside:.0%} of the curve in its band, {result.gain:.0%} of the true gain, "
        "force off by {:.3g} N without it, {:.3g} N with it".format(*result.forces),
        *(f"{n.name} {n.found:.4g} not {n.true:.4g}" for n in result.numbers if not n.right),
        flush=True,
    )


def print_summary(results):
    """Print shares, and what was taken for what."""
    groups = {
        "full size": lambda c: len(c.effects) == 1 and c.size == 1.0 and not c.outside,
        "half size": lambda c: len(c.effects) == 1 and c.size == 0.5 and not c.outside,
        "clean": lambda c: not c.effects,
        "outside the catalogue": lambda c: c.outside,
        "two at once": lambda c: len(c.effects) == 2,
    }
    for name, belongs in groups.items():
        found = [r for r in results if belongs(r.case)]
        found = [r for r in found if not r.absorbed or not r.case.effects]
        if found:
            right, wrong = sum(r.right for r in found), sum(r.wrong_name for r in found)
            print(
                f"{name}: {right} of {len(found)} right ({right / len(found):.0%}), "
                f"{wrong} named wrongly ({wrong / len(found):.1%})"
            )
    needless, named = sum(r.needless for r in results), sum(bool(r.causes) for r in results)
    print(f"a needless cause beside the right one: {needless} of {named}")
    absorbed = sum(r.absorbed for r in results if r.case.effects)
    print(f"absorbed by the plain law, and left out of these shares: {absorbed}")
    numbers = [n for r in results if r.right for n in r.numbers]
    true = sum(n.right for n in numbers)
    print(f"numbers within 10 % or their interval: {true} of {len(numbers)}")
    beside = [r.oracle for r in results if not math.isnan(r.oracle)]
    near = sum(ratio <= ORACLE for ratio in beside)
    print(f"held-out errors up to {ORACLE} of the oracle's: {near} of {len(beside)}")
    curves = [r for r in results if not math.isnan(r.inside)]
    if curves:
        explained = sum(r.left <= LEFT for r in curves)
        print(
            f"curves: {np.mean([r.inside for r in curves]):.0%} of the samples in their bands, "
            f"at most {LEFT:.0%} left in {explained} of {len(curves)}"
        )
        gains = [r.gain for r in curves if not math.isnan(r.gain)]
        near = sum(gain >= GAIN for gain in gains)
        print(f"gain at least {GAIN:.0%} of that of the true friction: {near} of {len(gains)}")
        forces = [r.forces for r in curves if not math.isnan(r.forces[0])]
        better = sum(extended < without for without, extended in forces)
        print(f"live force nearer with the function: {better} of {len(forces)}")
    taken = Counter(
        ("+".join(r.case.effects) or "clean", "+".join(r.causes) or r.verdict)
        for r in results
        if not r.right
    )
    for (true, named_causes), count in taken.most_common():
        print(f"  {true} taken for {named_causes}: {count}")
    print(f"seconds a record: median {np.median([r.seconds for r in results]):.1f}")


if __name__ == "__main__":
    main()
