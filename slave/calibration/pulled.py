"""Measurements of one tendon pulled against its stop."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.calibration.calibration import MeasuredValue
from slave.calibration.procedure_state import Phase, StopContact
from slave.calibration.refusals import format_tendon_name
from slave.calibration.run import ProcedureData

Rows = NDArray[np.bool_]

# [m] of travel before the contact, from and to: the joint moves freely there
FREE_TRAVEL = 2e-3, 3e-4
# times the low tension; a release that ends above it ended as the joint left its stop
RELEASE_RATIO_MAX = 1.5
STOP_TENSION_RATIO = 1.15  # times the tension at which the joint left its stop
REVERSAL_COUNTS = 2.5  # encoder counts from a reversal
RESOLUTION_MIN, RESOLUTION_MAX = 5e-7, 5e-6  # [m] of a count
PULL_SAMPLES_MIN = 100  # least samples of a first pull to be evaluated


class HysteresisLoop(NamedTuple):
    """Alternating pulls and releases against a stop, the tip at rest."""

    tension: Array  # [N]
    travel: Array  # [m]


class PulledTendon(NamedTuple):
    """One tendon of one joint in a record."""

    record: ProcedureData
    joint: int  # counted from 0
    side: int  # which of its tendons

    @property
    def tendon(self) -> int:
        """Its number in the rig."""
        return self.record.joints[self.joint][self.side]

    @property
    def name(self) -> str:
        """What messages call it."""
        return format_tendon_name(self.joint + 1, len(self.record.joints[self.joint]), self.side)

    @property
    def contact(self) -> StopContact:
        """The contact with its stop."""
        return self.record.stops[self.joint][self.side]

    @property
    def tension(self) -> Array:
        """Tension at the housing [N] in the whole record, zero offset removed."""
        return self.record.tension[:, self.tendon] - (self.zero or 0.0)

    @property
    def zero(self) -> float | None:
        """Zero offset of its load cell [N]: the reading while the other tendon was pulled."""
        if len(self.record.joints[self.joint]) == 1:
            return None
        slack = PulledTendon(self.record, self.joint, 1 - self.side).rows(Phase.RELEASE, Phase.PULL)
        return float(np.mean(self.record.tension[slack, self.tendon]))

    @property
    def travel(self) -> Array:
        """Motor travel [m] in the whole record."""
        return self.record.travel[:, self.tendon]

    def rows(self, *phases: Phase) -> Rows:
        """Return the mask of samples in which this tendon was pulled in one of these phases."""
        codes = [int(phase) for phase in phases]
        own = np.equal(self.record.side[:, self.joint], self.side)
        return np.asarray(own & np.isin(self.record.phase[:, self.joint], codes))

    @property
    def dragging(self) -> Rows:
        """Mask of samples in which it drew out the other tendon of its joint."""
        codes = self.record.phase[:, self.joint], self.record.side[:, self.joint]
        return np.asarray((codes[0] == Phase.DRAG) & (codes[1] == 2 + self.side))

    @property
    def first_pull(self) -> Rows:
        """Mask of the samples of the first pull after contact with the stop.

        The stop is detected a little late; contact is where the line of the pull crosses the
        tension of the free joint.
        """
        late = self.rows(Phase.SEEK) & (self.travel >= self.contact.travel)
        slope = fit_slope(self.tension[late], self.travel[late]).value
        over = max(0.0, self.contact.tension - self.free_tension)
        met = self.contact.travel - slope * over
        return self.rows(Phase.SEEK) & np.greater_equal(self.travel, met)

    @property
    def free_tension(self) -> float:
        """The tension [N] at which the joint moved just before its stop."""
        ahead = self.contact.travel - self.travel
        rows = self.rows(Phase.SEEK) & (ahead < FREE_TRAVEL[0]) & (ahead > FREE_TRAVEL[1])
        return float(np.median(self.tension[rows])) if rows.any() else self.contact.tension


def extract_loops(pulled: PulledTendon, low: float) -> list[HysteresisLoop]:
    """Return the alternating pulls and releases against the stop while the tip rested.

    As one loop, unless a return spring pulled the joint off its stop during the releases: then one
    loop per pull and release, without the samples in which the tip moved. A first pull that met the
    stop near its end is left out with its release.
    """
    of_release = pulled.record.releases[:, pulled.joint]
    count = int(of_release[pulled.rows(Phase.RELEASE)].max()) + 1
    pulls = [pulled.rows(Phase.PULL) & (of_release == i) for i in range(count)]
    releases = [pulled.rows(Phase.RELEASE) & (of_release == i) for i in range(count)]
    pulls[0] = pulled.first_pull
    if pulls[0].sum() < PULL_SAMPLES_MIN:
        pulls, releases = pulls[1:], releases[1:]
    ends = [float(np.median(pulled.tension[release][-5:])) for release in releases]
    if max(ends) <= RELEASE_RATIO_MAX * low:
        return [_build_loop(pulled, pulls, releases)]
    there = pulled.tension > STOP_TENSION_RATIO * max(ends)
    regained = pulled.tension > STOP_TENSION_RATIO * pulled.contact.tension
    return [
        _build_loop(pulled, [pull & regained], [release & there])
        for pull, release in zip(pulls, releases, strict=True)
    ]


def _build_loop(pulled: PulledTendon, pulls: list[Rows], releases: list[Rows]) -> HysteresisLoop:
    """Return the branches in order, without the samples at the reversals.

    There one encoder count corresponds to much tension, and the two branches cannot be separated.
    """
    branches = [branch for pair in zip(pulls, releases, strict=True) for branch in pair]
    rows = np.logical_or.reduce(branches)
    count = _estimate_resolution(pulled.travel[rows])
    for i, (before, after) in enumerate(pairwise(branches)):
        around = np.flatnonzero(before | after)
        ahead = pulled.travel[around] * (1.0 if i % 2 == 0 else -1.0)
        short = ahead.max() - ahead
        first = int(np.argmax(short <= REVERSAL_COUNTS * count))
        last = int(np.flatnonzero(short <= (REVERSAL_COUNTS + 1.0) * count)[-1])
        rows[around[first + 1 : last + 1]] = False
    return HysteresisLoop(pulled.tension[rows], pulled.travel[rows])


def _estimate_resolution(travel: Array) -> float:
    """Return the travel per encoder count [m], or a small value if there is no quantisation."""
    steps = np.diff(np.unique(travel))
    return float(min(max(steps.min(), RESOLUTION_MIN), RESOLUTION_MAX))


def fit_slope(T: Array, q: Array) -> MeasuredValue:
    """Return dq/dT [m/N] from tension and travel by least squares."""
    (slope, _), covariance = np.polyfit(T, q, 1, cov=True)
    return MeasuredValue(float(slope), math.sqrt(float(covariance[0, 0])))
