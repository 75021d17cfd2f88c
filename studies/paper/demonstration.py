"""One sheath in full, for the figures that repeat the paper's."""

import math
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.law.sheath import Sheath
from estimator.law.transmission import (
    build_slack_profile,
    build_tables,
    drive_proximal,
    evaluate_tension,
    observe,
)
from slave.calibration.run import CalibrationRefused
from slave.rigs.simulated.plant.chain import compute_response, recover_state
from slave.rigs.simulated.plant.response import interpolate_curve
from slave.rigs.simulated.plant.tendon import (
    SectionConfig,
    SheathConfig,
    build_chain,
    divide_sheath,
    get_tensions,
    init_chain_state,
)
from studies.paper import methods
from studies.paper.methods import METHODS, CalibratedMethod, Estimates, Initialisation
from studies.paper.outcome import Outcome
from studies.paper.sheaths import Specimen
from studies.paper.study import PROFILE, Session, experiment, judge

SPECIMEN = Specimen(
    number=0,
    kind="uniform",
    # K = 0.6: the paper's release from 20 N to 5 N reached the release phase, so its K was below
    # ln(20/5)/2 = 0.69; curvature constant as in its figure 1, the other numbers assumed
    sheath=SheathConfig(
        (SectionConfig(1.5, 0.225),), friction=0.09, axial_stiffness=9000.0, nodes=100
    ),
    tension_noise=0.02,
)
LEVELS = (20.0, 16.0, 12.5, 10.0, 8.0, 20.0 * math.exp(-2.0 * SPECIMEN.K), 4.5)  # [N] T_in
STEP = 1e-6  # [m] of the motor
DT = 1e-3  # [s] in which it goes there; nothing depends on it


class Distribution(NamedTuple):
    """The tension along the sheath at one T_in, in the plant and as it is estimated."""

    T_in: float  # [N]
    true_x: Array  # [m] from the housing
    true: Array  # [N]
    x: Array  # [m]
    estimate: Array  # [N]
    front: float  # [m] X', estimated
    front_tension: float  # [N] estimated


class Demonstration(NamedTuple):
    """The session, how it was judged, what each method made of the paper's profile, and T(x)."""

    session: Session
    initialised: Initialisation
    calibrated: CalibratedMethod
    outcome: Outcome
    estimates: dict[str, Estimates]
    distributions: list[Distribution]


def demonstrate(seed: int) -> Demonstration:
    """Go through the experiment with the sheath of the figures."""
    session = experiment(SPECIMEN, seed)
    initialised = session.initialised
    if isinstance(initialised, CalibrationRefused):
        raise initialised
    calibrated = initialised.ours
    if isinstance(calibrated, CalibrationRefused):
        raise calibrated
    record = session.records[PROFILE]
    estimates = {
        method: methods.fit_method(method, SPECIMEN, initialised).estimate(record)
        for method in METHODS
    }
    distributions = release(SPECIMEN.sheath, calibrated.tendon.model().sheath, LEVELS)
    return Demonstration(session, initialised, calibrated, judge(session), estimates, distributions)


def release(sheath: SheathConfig, model: Sheath, levels: tuple[float, ...]) -> list[Distribution]:
    """Pull a tendon whose tip is held to the first of `levels` [N], then release it to the others.

    `model` is driven by the T_in that the plant has at each.
    """
    cell, _ = divide_sheath(sheath)
    middles = np.cumsum(cell) - 0.5 * cell
    ends = np.concatenate([[0.0], middles, [cell.sum()]])
    true_x = 0.5 * (ends[:-1] + ends[1:])
    x = np.linspace(0.0, model.length, 301)
    table = build_tables(model)
    profile = build_slack_profile(table)
    chain = build_chain(sheath, 0.0)
    state, travel = init_chain_state(chain), 0.0
    found: list[Distribution] = []
    for level in levels:
        sense = 1.0 if not found else -1.0
        while sense * (level - get_tensions(chain, state)[0]) > 0.0:
            travel += sense * STEP
            response = compute_response(chain, state, travel, DT)
            tension = interpolate_curve(response.tip, 0.0)
            state = recover_state(chain, state, response, travel, 0.0, tension, DT)
        true = get_tensions(chain, state)
        profile = drive_proximal(table, profile, float(true[0]))
        seen = observe(table, profile)
        found.append(
            Distribution(
                float(true[0]),
                true_x,
                true,
                x,
                evaluate_tension(table, profile, x),
                seen.front,
                seen.T_front,
            )
        )
    return found
