"""Diagnose one bench in several sizes: the answer must not depend on it (make bench-scales).

Force times a, travel times b: verdict, causes and ratios must stay, numbers with a unit must go
along. The records are those of the hidden benches (about 20 N and 10 mm), multiplied.
"""

import argparse
import itertools
from functools import partial
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np

from estimator.diagnosis.api import diagnose
from estimator.effects import CATALOGUE, CHANNELS
from estimator.measured_data import Samples
from estimator.units import LINEAR, ROTARY
from studies import hidden

REFERENCE = "reference"
SIZES = {
    REFERENCE: (1.0, 1.0, LINEAR),
    "micro-surgical, 0.5 N and 0.3 mm": (1.0 / 40.0, 1.0 / 30.0, LINEAR),
    "heavy cable, 500 N and 80 mm": (25.0, 8.0, LINEAR),
    "instrument, 0.2 N m and 1 rad": (0.01, 100.0, ROTARY),
    "drive, 20 N m and 1 rad": (1.0, 100.0, ROTARY),
}
WORDS = {name.split(",")[0]: name for name in SIZES if name != REFERENCE}
CASES = (
    "",
    "friction_step",
    "stick_slip",
    "stribeck_friction",
    "presliding",
    "constant_drag",
    "proximal_tension_gain",
    "pulley_eccentricity",
    "creep",
    "encoder_slip",
)
AMONG = {*CASES, "viscous_friction", "sensor_lag", "tension_dependent_friction", "joint_friction"}
SPARED = 1e-3  # of a value, by which it may differ from that of the reference: no more than a fit


class Answer(NamedTuple):
    """What a diagnosis says, sizes undone."""

    verdict: str
    causes: tuple[str, ...]
    numbers: dict[str, tuple[float, float]]  # name -> value, half width of its interval


def diagnosed(case, force, travel, units, *, duration=30.0, rate=60.0, among=AMONG):
    """Return the answer for a hidden bench whose forces and travels are multiplied."""
    seed, name = case
    made = hidden.make(seed, (name,) if name else (), bench="spring", duration=duration, rate=rate)
    channels = [
        made.channels[channel] * (travel if "displacement" in channel else force)
        for channel in CHANNELS
    ]
    effects = [one for one in CATALOGUE if one.name in among]
    found = diagnose(Samples(made.time, *channels, units), effects=effects)
    numbers = {}
    for key, one in found.parameters.items():
        size = force ** _power(one.unit, ("N", "N m"), "kg") * travel ** _power(
            one.unit, ("m", "rad"), "", "kg"
        )
        numbers[key] = (one.value / size, 0.5 * (one.high - one.low) / size)
    return Answer(str(found.verdict), found.causes, numbers)


def _power(unit, base, more="", less=""):
    """Return the power of a dimension in a unit: of force or of travel."""
    unit = unit.replace("N m", "Nm").replace("kg m^2", "kg")
    base = {one.replace(" ", "") for one in base} | {more}
    above, _, below = unit.partition("/")

    def count(side):
        total = 0
        for one in side.strip("()").split(" "):
            name, _, power = one.strip("()").partition("^")
            total += int(power or 1) * ((name in base) - (name == less and bool(less)))
        return total if side else 0

    return count(above) - count(below)


def unlike(answer, reference):
    """Return in what an answer differs from that of the reference, in words."""
    out = []
    if answer[:2] != reference[:2]:
        out.append(f"{answer.verdict} {'+'.join(answer.causes)}")
    missing = np.nan, np.nan
    for name in {**reference.numbers, **answer.numbers}:
        (value, _), (true, half) = (one.numbers.get(name, missing) for one in (answer, reference))
        if not abs(value - true) <= max(0.5 * half, SPARED * abs(true)):  # nan: missing in one
            out.append(f"{name} {value:.4g} not {true:.4g}")
    return out


def _one(task, seed):
    name, size = task
    return name, size, diagnosed((seed, name), *SIZES[size])


def main():
    """Run all cases in all sizes and print what differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", nargs="*", default=CASES, help="of the effects; '' for none")
    parser.add_argument("--sizes", nargs="*", choices=WORDS, default=list(WORDS))
    args = parser.parse_args()
    tasks = list(itertools.product(args.only, [REFERENCE, *(WORDS[word] for word in args.sizes)]))
    answers = {}
    with get_context("spawn").Pool(args.jobs) as pool:
        for name, size, answer in pool.imap(partial(_one, seed=args.seed), tasks):
            reference = answers.setdefault(name, answer)
            off = unlike(answer, reference)
            print(
                "same " if not off else "OTHER",
                f"{name or 'clean':22} {size:34}",
                answer.verdict,
                "+".join(answer.causes),
                "; ".join(off),
                flush=True,
            )


if __name__ == "__main__":
    main()
