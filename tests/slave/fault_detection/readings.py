"""What a load cell with noise and steps makes of tensions."""

import numpy as np


def readings(tension, noise, resolution, seed=0):
    """Return what a cell makes of tensions."""
    noisy = tension + noise * np.random.default_rng(seed).standard_normal(tension.shape)
    return np.round(noisy / resolution) * resolution if resolution else noisy
