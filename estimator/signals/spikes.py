"""Single-sample spikes of a channel: found the same way wherever an error is counted."""

import numpy as np

from estimator.array_types import Array, Mask
from estimator.measured_data import MeasuredData, Samples
from estimator.noise_treatment import estimate_noise_sigma

SCATTER_FACTOR = 8.0  # the local scatter, by which a sample is off both its neighbours
SCATTER_WINDOW = 101  # samples of the local scatter
SAMPLES_MIN = 8  # samples that tell a scatter


def find_spikes(signal: Array) -> Mask:
    """Return which samples are single-sample spikes, shape (n,).

    A spike is off the mean of its neighbours by `SCATTER_FACTOR` times the local scatter, while
    its neighbours are near each other. Missing values (NaN) are no neighbours.
    """
    present = np.isfinite(signal)
    if not present.all():
        spikes = np.zeros(len(signal), dtype=np.bool_)
        spikes[present] = find_spikes(signal[present])
        return spikes
    if len(signal) < SAMPLES_MIN:
        return np.zeros(len(signal), dtype=np.bool_)
    from scipy.ndimage import median_filter  # here: the control processes import this module

    deviation = np.zeros_like(signal)
    deviation[1:-1] = signal[1:-1] - 0.5 * (signal[:-2] + signal[2:])
    gap = np.zeros_like(signal)
    gap[1:-1] = np.abs(signal[2:] - signal[:-2])
    usual = 1.4826 * median_filter(np.abs(deviation), SCATTER_WINDOW, mode="nearest")
    noise_min = max(estimate_noise_sigma(signal), 1e-3 * float(np.ptp(signal)))
    spike: Mask = np.abs(deviation) > SCATTER_FACTOR * np.maximum(usual, noise_min)
    spike &= gap < 0.5 * np.abs(deviation)
    # beside a spike both neighbours are off by half of it, the other way; beside a sharp turn not
    for neighbour in (np.roll(deviation, 1), np.roll(deviation, -1)):
        spike &= (deviation * neighbour < 0.0) & (np.abs(neighbour) > 0.25 * np.abs(deviation))
        spike &= np.abs(neighbour) < 0.8 * np.abs(deviation)
    return spike


def remove_spikes(data: MeasuredData) -> Samples:
    """Return data whose single-sample spikes are missing (NaN), each channel by itself."""
    q_p, T_out, q_d = (
        None if channel is None else mask_spikes(channel)
        for channel in (data.proximal_displacement, data.distal_tension, data.distal_displacement)
    )
    return Samples(data.time, mask_spikes(data.proximal_tension), q_p, T_out, q_d)


def mask_spikes(signal: Array) -> Array:
    """Return a signal with NaN for its single-sample spikes, shape (n,)."""
    return np.where(find_spikes(signal), np.nan, signal)
