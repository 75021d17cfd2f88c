"""First part of a check: what a rig measures at rest."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from estimator.array_types import Array
from slave.rig import Rig, RigSample
from teleop.errors import TeleopError
from teleop.runtime.clock import Tick

SAMPLES_MIN = 10  # samples


@dataclass(frozen=True)
class RestMeasurement:
    """Samples of a rig at rest: rates, means and noise of each tendon."""

    rate_hz: float
    longest_gap_s: float
    displacement: Array  # [m] shape (tendons,)
    displacement_noise: Array  # [m] standard deviation
    tension: Array  # [N]
    tension_noise: Array  # [N]


def measure_at_rest(
    rig: Rig, ticks: Iterable[Tick], start_ns: int, duration_s: float
) -> RestMeasurement:
    """Read for a while, move nothing; `TeleopError` if there are too few samples."""
    samples: list[RigSample] = []
    began_ns = None
    for tick in ticks:
        began_ns = tick.stamp_ns if began_ns is None else began_ns
        samples += rig.read((tick.stamp_ns - start_ns) * 1e-9)
        rig.advance()
        if (tick.stamp_ns - began_ns) * 1e-9 >= duration_s:
            break
    if len(samples) < SAMPLES_MIN:
        raise TeleopError(f"rig: {len(samples)} samples in {duration_s:g} s: check its sensors")
    return compute_rest_measurement(samples)


def compute_rest_measurement(samples: Sequence[RigSample]) -> RestMeasurement:
    """Return what samples of a rig at rest say."""
    times = np.array([sample.time_s for sample in samples])
    tension = np.array([sample.proximal_tension for sample in samples])
    displacement = np.array([get_displacement(sample) for sample in samples])
    return RestMeasurement(
        rate_hz=float((len(times) - 1) / (times[-1] - times[0])),
        longest_gap_s=float(np.diff(times).max()),
        displacement=displacement.mean(axis=0),
        displacement_noise=displacement.std(axis=0),
        tension=tension.mean(axis=0),
        tension_noise=tension.std(axis=0),
    )


def format_rest_measurement(found: RestMeasurement) -> list[str]:
    """Return the measurement as lines, with what is suspicious in it."""
    lines = [
        f"samples: {found.rate_hz:.0f} Hz, longest gap {found.longest_gap_s * 1e3:.1f} ms",
        f"{'tendon':>6} {'tension N':>18} {'displacement mm':>20}",
    ]
    for k, tension in enumerate(found.tension):
        lines.append(
            f"{k + 1:>6} {tension:>10.3f}±{found.tension_noise[k]:<7.3f} "
            f"{found.displacement[k] * 1e3:>11.4f}±{found.displacement_noise[k] * 1e3:<8.4f}"
        )
        if not np.isfinite(tension) or not np.isfinite(found.displacement[k]):
            lines.append("       no reading: check the cell's and the motor's number in the config")
        elif found.tension_noise[k] == 0.0:
            lines.append("       its tension does not vary at all: is the cell connected?")
        elif tension < -5.0 * found.tension_noise[k]:
            lines.append("       its tension is negative: cell.offset, or the sign of cell.scale")
    return lines


def get_displacement(sample: RigSample) -> Array:
    """Return the displacements [m] of a sample; NaN without encoders."""
    if sample.proximal_displacement is None:
        return np.full(len(sample.proximal_tension), np.nan)
    return sample.proximal_displacement
