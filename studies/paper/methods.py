"""The methods that are compared, from initialisation to estimates.

``paper``: Phee et al. 2009 as printed, but for the misprints (`studies.paper.paper_method`).

``paper at its best``: the same equations, M_e read as the slope of elongation over tension, which
leaves out what tension it took to reach the stop, and reversals continued where the paper's own
equations would jump.

``ours``: the calibration of `teleop calibrate` and the estimator of `teleop slave`.

The first two get the true length and stiffness of the sheath, as the paper assumes both known; ours
gets the length, on which neither of its outputs depends.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np

from estimator import noise_treatment
from estimator.array_types import Array
from estimator.online import online
from slave.calibration import procedure_run as initialisation
from slave.calibration.analysis import evaluate_tendons
from slave.calibration.calibration_file import TendonCalibration
from slave.calibration.config import InitialiseConfig, KnownSheathConfig
from slave.calibration.procedure_run import CalibrationRefused
from slave.calibration.procedure_state import Phase
from slave.calibration.tendon_identification import PulledTendon
from slave.gate import GateConfig
from slave.tendon_config import TendonConfig
from studies.paper import paper_method
from studies.paper.bench import LOOSE, PERIOD, BenchRun, Specimen, build_bench

PAPER, PAPER_AT_BEST, OURS = "paper", "paper at its best", "ours"
METHODS = (PAPER, PAPER_AT_BEST, OURS)

T = TypeVar("T")

GATE = GateConfig(displacement_min=-0.05, displacement_max=0.05, tension_max=30.0)
READ_OVER = 0.02  # [s] before the pull ends, over which T_in and e_out are read
FREE = (5e-4, 2e-3)  # [m] before the stop is felt: there the joint moved freely
STRAIGHT = 0.4  # of the largest tension, above which the pull against the stop is a straight line


class Figure(NamedTuple):
    """Quantities of the paper's figure 6, the first pull against the stop."""

    begins: float  # [m] travel where the line of the pull meets the tension of the free joint
    elongation: float  # e_out [m] from there to the end
    tension: float  # T_in [N] at the end
    slope: float  # [m/N] of the line
    noise: float  # [N] standard deviation of the load cell


class CalibratedMethod(NamedTuple):
    """The calibration of tendon a by `teleop calibrate`, from the initialisation of both."""

    direction: TendonCalibration
    tendon: TendonConfig


class Initialisation(NamedTuple):
    """Measurements of tendon a, and its calibration."""

    pulled: PulledTendon
    ours: CalibratedMethod | CalibrationRefused
    paper: Figure


class Estimates(NamedTuple):
    """Of a whole record, shape (n,)."""

    distal_tension: Array  # [N]
    elongation: Array  # [m]


class FittedMethod(NamedTuple):
    """A method after initialisation."""

    K: float
    estimate: Callable[[BenchRun], Estimates]


def require(result: T | CalibrationRefused) -> T:
    """Return a result, or raise the refusal that stands in its place."""
    if isinstance(result, CalibrationRefused):
        raise result
    return result


def initialise(specimen: Specimen, seed: int) -> Initialisation:
    """Run the paper's initialisation on the bench, its joint free.

    Raises
    ------
    CalibrationRefused
        If the procedure was aborted.
    """
    known = KnownSheathConfig(specimen.length)
    config = InitialiseConfig(sheaths=(known,), keep=LOOSE)
    rig = build_bench(specimen, seed, loaded=False)
    limits = initialisation.ProcedureLimits(config, GATE)
    driven = initialisation.run_procedure(
        rig, limits, initialisation.generate_fast_ticks(1.0 / PERIOD), 0, [0]
    )
    both = [PulledTendon(driven.record, joint=0, side=side) for side in (0, 1)]
    ours: CalibratedMethod | CalibrationRefused
    try:
        directions, tendons = evaluate_tendons(both, config)
        ours = CalibratedMethod(directions[0], tendons[0])
    except CalibrationRefused as refused:
        ours = refused
    return Initialisation(both[0], ours, read_figure(both[0]))


def fit_method(method: str, specimen: Specimen, initialised: Initialisation) -> FittedMethod:
    """Return a method fitted to tendon a's initialisation.

    Raises
    ------
    CalibrationRefused
        If the calibration fails.
    ValueError
        If the paper's (13) has no solution.
    """
    if method == OURS:
        return _fit_ours(require(initialised.ours))
    read, at_best = initialised.paper, method == PAPER_AT_BEST
    M_e = read.slope if at_best else read.elongation / read.tension
    model = paper_method.build_model(M_e, specimen.length, specimen.sheath.axial_stiffness)

    def estimate(record: BenchRun) -> Estimates:
        found = paper_method.run_method(
            model, record.time, record.tension, read.noise, continued=at_best
        )
        return Estimates(found.distal_tension, found.elongation)

    return FittedMethod(model.K, estimate)


def read_figure(pulled: PulledTendon) -> Figure:
    """Evaluate the first pull as in the paper's figure 6."""
    seeking = pulled.select_rows(Phase.SEEK)
    T, q = pulled.tension[seeking], pulled.travel[seeking]
    before = pulled.contact.travel - q
    free = float(np.median(T[(before > FREE[0]) & (before < FREE[1])]))
    straight = np.arange(len(q)) > np.flatnonzero(STRAIGHT * T.max() > T)[-1]
    slope, offset = np.polyfit(T[straight], q[straight], 1)
    last = slice(-round(READ_OVER / PERIOD), None)
    peak, end = float(T[last].mean()), float(q[last].mean())
    begins = float(offset + slope * free)
    return Figure(begins, end - begins, peak, float(slope), noise_treatment.estimate_noise_sigma(T))


def _fit_ours(calibrated: CalibratedMethod) -> FittedMethod:
    prepared = online.prepare(calibrated.tendon.build_model())

    def estimate(record: BenchRun) -> Estimates:
        found = online.run(prepared, record.time, record.tension, record.travel)
        return Estimates(found.distal_tension, found.elongation)

    return FittedMethod(calibrated.direction.K.value, estimate)
