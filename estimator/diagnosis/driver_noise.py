"""What the noise of what drives a simulation makes of it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from estimator.diagnosis.drive import estimate_drive
from estimator.diagnosis.record import Record
from estimator.effects.effect import Signals

DRAWS = 8  # of the driver's noise
AVERAGING_SAMPLES = 5  # samples over which the variance that it makes is averaged


class SimulatedSignals(Protocol):
    """What a simulation gives."""

    @property
    def signals(self) -> Signals:
        """By channel, shape (n,)."""


def propagate_driver_noise(
    record: Record, simulate: Callable[[Record], SimulatedSignals]
) -> Record:
    """Return a record whose `sigma` has in it what the driver's noise does to a simulation.

    Friction remembers where the driver turned, so an error of the driver shows most just behind a
    turn, where the tension changes with the root of the travel. `simulate` takes the record with
    noise put on its drive once more (parametric bootstrap); the variance that this makes of each
    channel is taken sample by sample.
    """
    sigma = record.noise[record.driver]
    if not sigma > 0.0:
        return record
    rng = np.random.default_rng(0)
    reference = simulate(record).signals
    variance = {channel: np.zeros_like(record.time) for channel in record.compared}
    for _ in range(DRAWS):
        noisy = record.drive + sigma * rng.standard_normal(len(record.time))
        drive = estimate_drive(record.driver, record.time, noisy, sigma).signal
        perturbed = simulate(replace(record, drive=drive)).signals
        for channel in variance:
            variance[channel] += (perturbed[channel] - reference[channel]) ** 2 / DRAWS
    kernel = np.full(AVERAGING_SAMPLES, 1.0 / AVERAGING_SAMPLES)
    return replace(
        record,
        sigma={
            channel: np.sqrt(
                record.noise[channel] ** 2 + np.convolve(channel_variance, kernel, mode="same")
            )
            for channel, channel_variance in variance.items()
        },
    )
