"""What load cells and encoders make of the truth: functions of time, value and motor travel."""

import numpy as np


def build_gain(gain):
    return lambda _t, y, _q: (1.0 + gain) * y


def build_bias(bias):
    return lambda _t, y, _q: y + bias


def build_drift(drift):
    """Zero at the start, `drift` at the end."""
    return lambda t, y, _q: y + drift * t / t[-1]


def build_delay(lag):
    return lambda t, y, _q: np.interp(t - lag, t, y)


def build_filter(lag):
    """First order, exact for readings that change evenly between samples."""

    def late(t, y, _q):
        if lag == 0.0:
            return y
        dt = t[1] - t[0]
        out, keep = np.empty_like(y), np.exp(-dt / lag)
        out[0] = y[0]
        for i in range(1, len(y)):
            slope = (y[i] - y[i - 1]) / dt
            now = y[i] - slope * lag
            out[i] = now + (out[i - 1] - (y[i - 1] - slope * lag)) * keep
        return out

    return late


def build_slip(slip, when):
    return lambda t, y, _q: y + slip * (t >= when)


def build_wave(amplitude, radius, order, phase):
    """A ripple over the angle of the motor's pulley."""
    return lambda _t, y, q: y + amplitude * np.sin(order * q / radius + phase)


def apply_play(travel, width):
    """Follow `travel` with a play of `width`: stays while it can."""
    out = np.empty_like(travel)
    now = travel[0]
    for i, x in enumerate(travel):
        now = min(max(now, x - width / 2), x + width / 2)
        out[i] = now
    return out


def build_rub(force, give):
    """+-force by the direction in which the motor moves, taken up over a way of `give`."""
    return lambda _t, y, q: y + force * (q - apply_play(q, 2 * give)) / give


def measure_channel(rng, y, *, noise=0.0, resolution=0.0, ceiling=np.inf):
    """Return the reading with white noise, no more than `ceiling`, in whole steps."""
    y = np.minimum(y + noise * rng.standard_normal(len(y)), ceiling)
    return resolution * np.round(y / resolution) if resolution else y
