"""What a motor and an environment do to a tendon, played through the brute-force chain.

A scenario is a list of legs; a leg is (seconds, motor, tip): the motor travels by so many metres,
the tip is held, moved by so many metres, loaded to a tension or tied to a spring.
"""

from typing import NamedTuple

import numpy as np

from estimator.law.sheath import Sheath
from studies.brute_force.chain import Chain, Force, Position, Spring

RATE = 500.0


class Record(NamedTuple):
    time: np.ndarray
    T_in: np.ndarray
    q_p: np.ndarray
    T_out: np.ndarray
    q_d: np.ndarray
    leg: np.ndarray  # index of the leg each sample belongs to


def held(travel=0.0):
    """Hold the tip, or move it by `travel` [m] over the leg (negative: away from the motor)."""
    return lambda part, start: Position(start[1] + part * travel)


def loaded(tension):
    """Bring T_out to `tension` [N]."""
    return lambda part, start: Force(start[0] + part * (tension - start[0]))


def spring(stiffness):
    """Tie the tip to a spring that carries the present T_out at the present place."""
    return lambda _part, start: Spring(stiffness, start[1] - start[0] / stiffness)


def play(sheath: Sheath, legs, beads=40) -> Record:
    sections = [(section.length, section.radius) for section in sheath.sections]
    chain = Chain(sections, sheath.friction, sheath.axial_stiffness, beads=beads)
    rows, motor = [], 0.0
    for index, (seconds, travel, tip) in enumerate(legs):
        start = (chain.T_out, chain.travel[-1])
        for part in np.linspace(0.0, 1.0, round(seconds * RATE) + 1)[1:]:
            chain.move(Position(motor + part * travel), tip(part, start))
            rows.append((chain.T_in, motor + part * travel, chain.T_out, chain.travel[-1], index))
        motor += travel
    T_in, q_p, T_out, q_d, leg = np.array(rows).T.copy()  # one type of array to compile for
    return Record(np.arange(len(T_in)) / RATE, T_in, q_p, T_out, q_d, leg.astype(int))


PULL, REST = (0.5, 1.6e-3, held()), (0.1, 0.0, held())
SCENARIOS = {
    "tip yields after a pull": [PULL, REST, (0.3, 0.0, loaded(1.5)), REST, (0.3, -0.25e-3, held())],
    "tip is drawn out after a pull": [PULL, REST, (0.6, 0.0, loaded(48.0)), REST],
    "tip is drawn out, then let go, after a pull": [
        PULL,
        REST,
        (0.6, 0.0, loaded(48.0)),
        REST,
        (0.6, 0.0, loaded(3.0)),
        REST,
    ],
    "hidden load, then the motor pulls on": [
        PULL,
        REST,
        (0.3, 0.0, loaded(15.0)),
        REST,
        (0.4, 0.6e-3, held()),
    ],
    "hidden load, then the motor releases": [
        PULL,
        REST,
        (0.3, 0.0, loaded(15.0)),
        REST,
        (0.4, -1.2e-3, held()),
    ],
    "tip is drawn out after a release": [
        PULL,
        (0.5, -1.1e-3, held()),
        REST,
        (0.4, 0.0, loaded(20.0)),
        REST,
    ],
    "tip yields after a release": [
        PULL,
        (0.5, -1.1e-3, held()),
        REST,
        (0.4, 0.0, loaded(0.4)),
        REST,
    ],
    "nested reversals, then the tip is drawn out": [
        PULL,
        (0.3, -0.5e-3, held()),
        (0.2, 0.2e-3, held()),
        REST,
        (0.5, 0.0, loaded(40.0)),
        REST,
    ],
    "nested reversals, then the tip yields": [
        PULL,
        (0.3, -0.5e-3, held()),
        (0.2, 0.2e-3, held()),
        REST,
        (0.4, 0.0, loaded(0.8)),
        REST,
    ],
    "spring at the tip": [
        (0.6, 6e-3, spring(2e3)),
        (0.8, -5e-3, spring(2e3)),
        (0.5, 4e-3, spring(2e3)),
        REST,
    ],
    "free tip meets a wall": [
        (0.2, 0.2e-3, held()),
        (0.5, 10e-3, loaded(1.0)),
        (0.5, 1.4e-3, held()),
        REST,
        (0.5, -1.2e-3, held()),
    ],
    "tip slips off while the motor pulls": [
        PULL,
        (0.2, 0.3e-3, loaded(1.0)),
        (0.3, 0.6e-3, held()),
    ],
    "tip slips off while the motor releases": [PULL, (0.2, -0.1e-3, loaded(1.0)), REST],
}


HIDDEN = {
    "hidden load, then the motor pulls on": (2, 3, 4),
    "hidden load, then the motor releases": (2, 3, 4),
}
"""Legs at whose end the tip has changed and the housing tells nothing, or only by its stiffness."""


def random_legs(rng, tip_moves=True):
    """Return a pull and seven legs of a motor and an environment that do as they please."""
    motor = rng.uniform(1.2e-3, 2.0e-3)
    legs = [(0.4, motor, held())]
    for _ in range(7):
        kind = rng.integers(5 if tip_moves else 2)
        seconds = rng.uniform(0.3, 0.6)
        target = motor if kind in {2, 3} else rng.uniform(0.7e-3, 2.2e-3)
        tip = loaded(rng.uniform(1.5, 20.0)) if kind > 2 else held()
        legs.append((seconds, target - motor, tip))
        motor = target
    return legs
