"""Joints on the simulated rig: each fault is found in time, by its name; healthy ones have none."""

import math

import numpy as np
import pytest

from slave.simulation.effects.elasticity import BrokenTendon, JammedTendon
from slave.simulation.effects.sensors import RepeatedSamples, Saturation, StuckCell
from slave.simulation.environment import LoadMotorConfig, TissueConfig, WallConfig
from studies.testbed.control_bench import build_joint, build_sine, follow
from teleop.session.state_machine import Reason

BROKEN, JAMMED = Reason.TENDON_BROKEN, Reason.TENDON_JAMMED
SATURATED, STUCK = Reason.CELL_SATURATED, Reason.CELL_STUCK
LOADED = build_joint(0.8, spring=300.0)
SWING = build_sine(0.006, 0.5)


def first_found(effect, joint=LOADED, seconds=4.0, command=SWING):
    """Return how long after its start a fault is found [s], and what is."""
    record = follow([joint], [command], seconds, effects=[effect], until_found=True)
    assert record.found
    time, finding = record.found[0]
    return time - effect.start, finding


@pytest.mark.parametrize(("start_at", "share"), [(0.5, 0.05), (1.5, 0.95)])  # driving, loose
def test_a_broken_tendon_is_found_in_a_fifth_of_a_second(share, start_at):
    effect = BrokenTendon(start=start_at, tendon="a", share=share)
    after, finding = first_found(effect)
    assert finding == (BROKEN, 0)
    assert after < 0.2


@pytest.mark.slow
def test_a_broken_tendon_of_a_joint_that_has_but_one_is_found_once_it_is_reeled_in():
    alone = build_joint(0.4, spring=300.0, tendons=1, pretension=2.0)
    effect = BrokenTendon(start=0.5, tendon="a")
    after, finding = first_found(effect, alone, 6.0, lambda _: (0.002, 0.0))
    assert finding == (BROKEN, 0)
    assert after < 5.0


@pytest.mark.parametrize(
    ("share", "within"), [pytest.param(0.0, 0.1, marks=pytest.mark.slow), (0.5, 0.3)]
)
def test_a_jammed_tendon_is_found_as_soon_as_it_is_pulled(share, within):
    after, finding = first_found(JammedTendon(start=2.15, tendon="a", share=share))
    assert finding == (JAMMED, 0)
    assert after < within


def test_a_stuck_cell_is_found_in_an_eighth_of_a_second():
    after, finding = first_found(StuckCell(start=1.85, tendon="b"))
    assert finding == (STUCK, 1)
    assert after < 0.125


def test_a_saturated_cell_is_found_while_the_motor_pulls():
    record = follow([LOADED], [SWING], 2.0, until_found=True)
    assert record.tension[:, 0].max() > 3.0
    after, finding = first_found(Saturation(tendon="a", limit=2.0))
    assert finding == (SATURATED, 0)
    assert after < 0.5


def wanderings(rng, extent, seconds):
    """Return a random profile of a load motor."""
    times = np.cumsum(rng.choice([0.05, 0.2, 0.5], 200))
    times = times[times < seconds].tolist()
    return tuple((time, float(rng.uniform(-extent, extent))) for time in times)


def random_command(rng, extent, seconds):
    """Return reaches between random places, some fast, some after a rest."""
    times, places = [0.0], [0.0]
    while times[-1] < seconds:
        place = rng.uniform(-extent, extent)
        times.append(times[-1] + max(abs(place - places[-1]) / rng.uniform(0.003, 0.03), 0.05))
        places.append(place)
        times.append(times[-1] + rng.choice([1e-3, 0.1, 0.4]))
        places.append(place)

    def at(time):
        k = int(np.searchsorted(times, time, side="right")) - 1
        span, way = times[k + 1] - times[k], places[k + 1] - places[k]
        u = (time - times[k]) / span
        return places[k] + way * u * u * (3.0 - 2.0 * u), way * 6.0 * u * (1.0 - u) / span

    return at


HEALTHY = ("free", "wall", "tissue", "pushed", "dragged", "stops", "coarse", "noiseless", "repeats")


@pytest.mark.parametrize(
    "what",
    [what if what == "pushed" else pytest.param(what, marks=pytest.mark.slow) for what in HEALTHY],
)
def test_a_healthy_joint_raises_no_alarm(what):
    rng, seconds = np.random.default_rng(HEALTHY.index(what)), 4.0
    K = rng.uniform(0.4, 1.8)
    settings = {
        "noise": rng.uniform(0.01, 0.03),
        "spring": 600.0 * math.exp(-K) * rng.integers(2),
        "friction": 0.1 * rng.integers(3),
    } | {
        "wall": {"environment": WallConfig(position=0.002, stiffness=5e4)},
        "tissue": {"environment": TissueConfig(position=0.001)},
        "pushed": {"environment": LoadMotorConfig(profile=wanderings(rng, 1.5, seconds))},
        "dragged": {
            "environment": LoadMotorConfig(
                mode="position", profile=wanderings(rng, 0.004, seconds), stiffness=1000.0
            )
        },
        "stops": {"stops": (-0.003, 0.004)},
        "coarse": {"resolution": 0.1, "noise": 0.0},
        "noiseless": {"resolution": 0.0, "noise": 0.0},
    }.get(what, {})
    effects = [RepeatedSamples(share=0.3, burst=20.0)] if what == "repeats" else []
    errors = rng.uniform(0.98, 1.02), rng.uniform(0.97, 1.03)
    command = random_command(rng, 0.006, seconds)
    record = follow(
        [build_joint(K, **settings)], [command], seconds, errors=errors, effects=effects, seed=7
    )
    assert record.found == ()
