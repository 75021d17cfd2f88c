"""One sheath through the whole experiment, and what each method made of it."""

import math
from typing import NamedTuple

import numpy as np

from estimator.law import closed_forms
from slave.calibration.run import CalibrationRefused
from studies.paper import methods, scoring
from studies.paper.bench import build, stretch_at_rest
from studies.paper.methods import METHODS, Initialisation
from studies.paper.outcome import Outcome, Result
from studies.paper.protocol import NESTED_TURNS, PAPER_TURNS, BenchRun, perform
from studies.paper.scoring import PHASES, WHOLE, Truth
from studies.paper.sheaths import Specimen

PROFILE, NESTED = "pull, release, pull", "nested reversals"
MOTIONS = {PROFILE: PAPER_TURNS, NESTED: NESTED_TURNS}
STRAIGHT = 1e6  # [m] bend radius of a straight section, for equations that need one


class Session(NamedTuple):
    """What was done with one sheath."""

    specimen: Specimen
    initialised: Initialisation | CalibrationRefused
    records: dict[str, BenchRun]  # by motion


def experiment(specimen: Specimen, seed: int) -> Session:
    """Initialise the bench and go through the motions; the same seed gives the same session."""
    seeds = np.random.SeedSequence((seed, specimen.number)).generate_state(1 + len(MOTIONS))
    initialised: Initialisation | CalibrationRefused
    try:
        initialised = methods.initialise(specimen, int(seeds[0]))
    except CalibrationRefused as refused:
        initialised = refused
    stretch = stretch_at_rest(specimen)
    records = {
        motion: perform(build(specimen, int(one), loaded=True), turns, stretch)
        for one, (motion, turns) in zip(seeds[1:], MOTIONS.items(), strict=True)
    }
    return Session(specimen, initialised, records)


def judge(session: Session) -> Outcome:
    """Return how far every method was off."""
    results = {method: _result(session, method) for method in METHODS}
    return Outcome(session.specimen, unevenness(session.specimen), results)


def truth_of(motion: str, record: BenchRun) -> Truth:
    """Return what the bench says, and the phases where there are such."""
    counts = scoring.taut(record.tension)
    parts = {WHOLE: counts}
    if motion == PROFILE:
        label = scoring.phases(record.leg, record.tension, record.distal_tension)
        parts |= {name: counts & (label == i) for i, name in enumerate(PHASES)}
    return Truth(record.distal_tension, record.elongation, parts)


def unevenness(specimen: Specimen) -> float:
    """Return ln(M_rel/M_pull) - K (docs/theory.md (T4)).

    Zero where curvature is spread evenly or alike from both ends, above zero where the bends are at
    the motor, below zero where they are at the tip.
    """
    sheath = specimen.sheath
    lengths = [section.length for section in sheath.sections]
    radii = [min(section.radius, STRAIGHT) for section in sheath.sections]
    constants = (sheath.friction, lengths, radii, sheath.axial_stiffness)
    ratio = closed_forms.compute_release_constant(*constants) / closed_forms.compute_pull_constant(
        *constants
    )
    return math.log(ratio) - specimen.K


def _result(session: Session, method: str) -> Result:
    try:
        fit_method = methods.fit_method(method, session.specimen, _initialised(session))
    except (CalibrationRefused, ValueError) as error:
        return Result(math.nan, str(error), {})
    scores = {
        motion: scoring.score(truth_of(motion, record), *fit_method.estimate(record))
        for motion, record in session.records.items()
    }
    return Result(fit_method.K, "", scores)


def _initialised(session: Session) -> Initialisation:
    if isinstance(session.initialised, CalibrationRefused):
        raise session.initialised
    return session.initialised
