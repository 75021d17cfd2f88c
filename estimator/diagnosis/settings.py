"""All thresholds of the diagnosis in one place, but for those of `estimator.signals`.

Where no source is named, a value is a choice; studies/hidden_effects measures how often the verdict
on simulated benches is right with it. How hard the fits search (rounds, starts, steps) stands where
it is used.
"""

from collections.abc import Callable
from dataclasses import dataclass

from estimator.law.sheath import ASSUMED_COMPLIANCE


@dataclass(frozen=True, slots=True)
class Settings:
    """Thresholds, by the decision that they are for."""

    # which samples of a record count (record.py)
    samples_min: int = 100  # of a record that is accepted
    samples_max: int = 20_000  # that are simulated; a longer record is averaged
    function_block: float = 0.25  # of a block's length, where a free function is looked for
    short_block: float = 0.02  # of a block's length, where the error fills but a block or two
    noise_min: float = 2e-4  # of a channel's range; nothing is simulated more precisely
    reversals_max: float = 0.3  # of the samples, that are left out beside reversals
    push_share: float = 0.1  # of the largest effort, of the other sign: a closed loop, no tendon
    hidden_tension: float = 4.0  # sigma: a tension so far off shows a motion that travel hides,
    hidden_tension_end: float = 2.0  # until it is no further off than that;
    hidden_travel: float = 3.0  # sigma: the motion may be so far from the measured travel,
    hidden_travel_max: float = 5.0  # sigma, in one sample;
    hidden_share: float = 0.3  # of the samples at most: more are no noise
    loose_tension: float = 0.5  # [N] at the tip that hardly moves what it pulls at

    # when a record starts slack, and where it is taut then (dataset.py)
    assumed_compliance: float = ASSUMED_COMPLIANCE  # [m/N] L/EA without a travel
    slack_noise: float = 3.0  # in sigma: tension below which the start is slack
    taut_sigma: float = 2.0  # standard deviations of the tension: how surely the start tells it
    taut_sigma_min: float = 1e-6  # [m]

    # what a residual is measured in (dataset.py)
    scale_min: float = 3e-3  # of a channel's range, while nothing is fitted yet
    accuracy: float = 1e-3  # of a channel's range by which a simulation is off itself
    residual_share: float = 0.3  # of the rms residual of a model, added to the noise
    noise_ratio: float = 1.25  # rms residual over tolerance up to which nothing is wrong

    # how probable held-out data are (scoring.py)
    bin_width: float = 1.0  # [s] of errors that are resampled together; longer than they correlate
    variance_min: float = 0.5  # noise variances: a mean square below it is not better
    independent_min: float = 0.02  # of the samples that count, however correlated they are
    excess_min: float = 0.1  # noise variances over 1 below which a channel has nothing to explain
    excess_ratio_max: float = 4.0  # by which one channel may become worse, for the mean over all

    # which candidates are followed (screening.py, causes.py)
    candidates_kept: tuple[int, ...] = (14, 6)  # effects that go on after each round of fits
    cost_ratio_max: tuple[float, ...] = (40.0, 4.0)  # times the lowest cost, after each of them
    bound_tolerance: float = 0.03  # of a bound: a number so near to it hardly leaves it again
    lead_cost_ratio: float = 1.5  # of any other's cost to its own: followed, not enough alone

    # when an effect is named (causes.py); docs/how-to/diagnose.md, Verdicts
    score_min: float = 15.0  # log-likelihood ratio less the BIC penalty (Schwarz 1978)
    gain_min: float = 0.04  # by which it lowers the error
    confidence: float = 0.98  # share of bootstrap resamples in which it is better
    unexplained_fraction_max: float = 0.25  # of the error beyond noise, with the named effects
    # of what named causes leave, with a free function instead: less, and they are not the cause
    free_function_fraction: float = 0.3

    # of a channel's rms about its mean, beyond noise, that a model of a tendon may leave
    foreign_share_max: float = 0.3
    foreign_share_law: float = 0.9  # that the capstan law leaves: no other law is tried
    foreign_share_stop: float = 0.6  # that the base law and all first fits leave: the search ends

    # of a tension, that friction takes at least where a sheath is seen at all
    friction_share_min: float = 0.02  # twice the least K that is tried
    # by which share a learned model's error is surely lower, so that the law misses something
    learned_gain_min: float = 0.05

    # when two effects are not told apart (causes.py)
    equivalent_score_max: float = 6.0  # log-likelihood ratio, penalties included
    equivalent_fraction_max: float = 0.015  # of the error beyond noise
    uncertain_fraction_max: float = 0.1  # of it, where the bootstrap does not prefer one
    rivals_max: int = 2  # that are reported beside the cause

    # when to look no further (causes.py)
    residual_fraction_min: float = 0.01  # of the first error beyond noise
    tolerance_ratio_max: float = 2.5  # rms residual over tolerance
    localised_share: float = 0.8  # of the misfit in two neighbouring blocks: blocks become short

    search_time_max: float = 100.0  # [s] of simulations (dataset.py), in which searches must end

    # what a part of the samples tells (fit.py)
    uncertainty_ratio_max: float = 4.0  # of that from all samples: above it, no refit

    # intervals, and what residuals depend on (intervals.py, scoring.py)
    onset_max: float = 60.0  # [s] that an onset is tried to be off by
    dependence_min: float = 0.05  # of a residual's variance that is reported
    dependence_bins: int = 12


SETTINGS = Settings()


# --- time of a long computation, and its progress, reported by its parts


class TimeBudget:
    """The time that searches may take.

    Parameters
    ----------
    limit : float
        [s] from now on. A search begins if the longest one so far would end within it.
    clock : callable
        Returns the time [s].
    """

    def __init__(self, limit: float, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._begin = clock()
        self._end = self._begin + limit
        self._longest = 0.0
        self.untried: list[str] = []
        """The searches that it had no time for."""

    def has_time(self, search: str, following: int = 0) -> bool:
        """Return whether the next search may begin, with time for `following` ones after it.

        The search before ends here.
        """
        now = self._clock()
        self._longest, self._begin = max(self._longest, now - self._begin), now
        if now + (1 + following) * self._longest < self._end:
            return True
        self.untried.append(search)
        return False


ProgressCallback = Callable[[str, float], None]
"""Told what is being done, and which share (0 to 1) of all is done."""


def ignore_progress(_what: str, _share: float) -> None:
    """Report nothing."""


def scale_progress(report: ProgressCallback, begin: float, end: float) -> ProgressCallback:
    """Return a callback for a part that takes the whole from share `begin` to `end`."""

    def report_part(task: str, share: float) -> None:
        report(task, begin + (end - begin) * share)

    return report_part
