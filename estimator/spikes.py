"""Single-sample spikes of a channel: found the same way wherever an error is counted."""

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.measured_data import MeasuredData, Samples
from estimator.signals import noise_sigma

SCATTER_FACTOR = 8.0  # the local scatter, by which a sample is off both its neighbours
SCATTER_WINDOW = 101  # samples of the local scatter
SAMPLES_MIN = 8  # samples that tell a scatter


def find_spikes(signal: Array) -> NDArray[np.bool_]:
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

    off = np.zeros_like(signal)
    off[1:-1] = signal[1:-1] - 0.5 * (signal[:-2] + signal[2:])
    across = np.zeros_like(signal)
    across[1:-1] = np.abs(signal[2:] - signal[:-2])
    usual = 1.4826 * median_filter(np.abs(off), SCATTER_WINDOW, mode="nearest")
    least = max(noise_sigma(signal), 1e-3 * float(np.ptp(signal)))
    spike: NDArray[np.bool_] = np.abs(off) > SCATTER_FACTOR * np.maximum(usual, least)
    spike &= across < 0.5 * np.abs(off)
    # beside a spike both neighbours are off by half of it, the other way; beside a sharp turn not
    for beside in (np.roll(off, 1), np.roll(off, -1)):
        spike &= (off * beside < 0.0) & (np.abs(beside) > 0.25 * np.abs(off))
        spike &= np.abs(beside) < 0.8 * np.abs(off)
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
