"""What the motor does: drawn at random, but always so that it tells a diagnosis something.

A motion is a list of legs, each to a tension, at a speed, with a rest behind it. It starts slack,
makes the same swing at the start and at the end, and in between, in random order, a slow pull with
holds, a fast swing, nested reversals, and a return to complete slack. A rehearsal on the clean
chain tells which travels of the motor have these tensions; the data are driven by the travels.
"""

from typing import NamedTuple

import numpy as np

from studies.hidden_effects.chain import Law, build_resting_state, step

CORNER = 0.15  # [s] in which the motor changes its speed
SLACK = -0.08  # of full travel, where there is no tension for sure
PACE = 100  # steps of a rehearsal over the full travel


class Leg(NamedTuple):
    """To a tension [N] (None: to complete slack), at a speed [full travels/s], then rest [s]."""

    tension: float | None
    speed: float
    rest: float = 0.0


class Schedule(NamedTuple):
    """Where the motor is when: corners of its path, and holds as (start, end)."""

    times: np.ndarray  # [s]
    travels: np.ndarray  # [m]
    holds: list  # [s]


def draw_legs(rng):
    """Return the legs of one motion."""

    def about(value):
        return value * rng.uniform(0.9, 1.1)

    def low():
        return rng.uniform(0.3, 1.0)

    slow, medium, fast = about(0.13), about(0.5), about(1.2)
    top = rng.uniform(18.0, 20.5)
    swing = [Leg(top, medium), Leg(low(), medium, 0.3)]
    pull = [
        Leg(rng.uniform(17.0, 20.0), slow, rng.uniform(8.2, 9.0)),
        Leg(rng.uniform(5.0, 9.0), medium, rng.uniform(8.2, 9.0)),
        Leg(low(), about(0.3), 0.2),
    ]
    rush = [
        Leg(rng.uniform(17.0, 20.5), fast, 0.2),
        Leg(rng.uniform(2.0, 5.0), fast),
        Leg(rng.uniform(11.0, 16.0), fast),
        Leg(low(), fast, 0.3),
    ]
    shares = [0.95, 0.4, 0.8, 0.55, 0.7, 0.6, 0.9]
    nested = [Leg(top * about(s) * 0.95, rng.choice([0.35, 0.7, 1.0])) for s in shares]
    nested.append(Leg(low(), medium, 0.2))
    if rng.random() < 0.5:
        nested[3] = nested[3]._replace(rest=rng.uniform(8.0, 8.5))
    loose = [Leg(None, medium, rng.uniform(0.8, 1.2)), Leg(rng.uniform(8.0, 14.0), about(0.3))]
    loose.append(Leg(low(), medium, 0.2))
    blocks = [pull, rush, nested, loose]
    rng.shuffle(blocks)
    return [*swing, *(leg for block in blocks for leg in block), *swing]


def rehearse_legs(line, tip, legs):
    """Return the motor's travel [m] at the start and the end of each leg, and the full travel.

    Full travel is that of a pull to 20 N. `line` has no effects.
    """
    law = Law()
    state = build_resting_state(line, law, tip)
    begin = state.x[0]
    full = _pull_to(line, law, tip, state, 20.0, 2e-5) - begin
    state = build_resting_state(line, law, tip)
    ends = [begin]
    for leg in legs:
        if leg.tension is None:
            there = begin + SLACK * full
            while state.x[0] > there:
                _move_motor(line, law, tip, state, max(there, state.x[0] - full / PACE))
            ends.append(there)
        else:
            ends.append(_pull_to(line, law, tip, state, leg.tension, full / PACE))
    return np.array(ends), full


def compute_arriving_tension(line, tip):
    """Return the tension at the tip when the first pull reaches 20 N at the housing."""
    state = build_resting_state(line, Law(), tip)
    _pull_to(line, Law(), tip, state, 20.0, 2e-5)
    return state.tension[line.tip - 1]


def _move_motor(line, law, tip, state, motor):
    before, after = np.array([[state.x[0], 0.0, 1.0, 0.0], [motor, 0.0, 1.0, 0.0]])
    step(line, law, tip, state, before, after, 1.0)


def _pull_to(line, law, tip, state, tension, pace):
    """Move the motor until the line has a tension at the housing; return its travel [m]."""
    direction = 1.0 if tension > state.tension[0] else -1.0
    while True:
        x, T = state.x[0], state.tension[0]
        _move_motor(line, law, tip, state, x + direction * pace)
        if (state.tension[0] - tension) * direction >= 0.0:
            share = (tension - T) / (state.tension[0] - T)
            return x + direction * pace * share


def build_schedule(legs, ends, full, duration):
    """Return the way through `ends`, from where the first leg begins, in so many seconds.

    Rests stay as long as they are unless they fill the record; the speeds give way.
    """
    rests = np.array([0.5, *(leg.rest for leg in legs)])
    rests *= min(1.0, 0.6 * duration / rests.sum())
    moves = np.abs(np.diff(ends)) / (full * np.array([leg.speed for leg in legs]))
    moves *= (duration - rests.sum() - 0.3) / moves.sum()
    arrivals = rests[0] + np.cumsum(moves + rests[1:]) - rests[1:]
    departures = arrivals + rests[1:]
    times = np.concatenate([[0.0, rests[0]], np.ravel(np.transpose([arrivals, departures]))])
    holds = [(a, d) for a, d in zip(arrivals + CORNER, departures, strict=True) if d - a > 4.0]
    return Schedule(times, np.repeat(ends, 2), holds)


def trace_motor(way, time, start, more):
    """Return the motor's travel [m] at `time` [s]: from `start`, then `more` than the schedule."""
    corner = max(1, round(CORNER / time[1]))
    early = np.arange(-corner, 0) * time[1]
    travels = np.concatenate([[start, start], way.travels[2:] + more])
    sums = np.cumsum(np.insert(np.interp(np.append(early, time), way.times, travels), 0, 0.0))
    return (sums[corner + 1 :] - sums[1:-corner]) / corner
