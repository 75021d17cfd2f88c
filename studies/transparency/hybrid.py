"""Hybrid parameters over frequency, how they are measured, and Llewellyn's criterion.

With force f and velocity v at the hand (1) and at the tip (2), f_e against the tip's motion,

    | f_h  |   | h11  h12 | | v_h |
    | -v_e | = | h21  h22 | | f_e |

(Hannaford, "A design framework for teleoperators with kinesthetic feedback", IEEE Trans. Robotics
and Automation 5, 1989, 426-434). With a force scale b and a motion scale a the ideal is h11 = 0,
h12 = b, h21 = -a, h22 = 0. The device is on this side of port 1: f_h is what the hand does on it.

Two experiments tell them: the hand is moved by a multisine and the load on the tip is constant
(f_e = 0 at all lines), then the hand is held (v_h = 0) and the load is a multisine. So each tells
one column by itself.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from studies.transparency.hand import DT, Device, GuidedHand
from studies.transparency.system import SETTLED, RunData, System, cut_run, run_hand

# --- signals with few lines in their spectrum, and what a system answered at those lines
# A multisine has odd harmonics of its period only, so that a system that is not linear answers at
# harmonics that were not asked (Pintelon & Schoukens, "System Identification: A Frequency Domain
# Approach", 2nd ed. 2012, chapters 3 and 4).


Lines = NDArray[np.complex128]


class Multisine(NamedTuple):
    """Sines of one period."""

    period: float  # [s]
    harmonics: tuple[int, ...]
    amplitude: tuple[float, ...]
    phase: tuple[float, ...]

    @property
    def frequency(self) -> Array:
        """Of each line [Hz]."""
        return np.array(self.harmonics) / self.period

    def at(self, time: float) -> float:
        """Return its value at a time [s]."""
        turns = 2.0 * np.pi * self.frequency * time + np.array(self.phase)
        return float(np.dot(self.amplitude, np.sin(turns)))


def draw_multisine(
    period: float, harmonics: tuple[int, ...], amplitude: Array, seed: int
) -> Multisine:
    """Return a multisine with phases by `seed`."""
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(harmonics))
    return Multisine(period, harmonics, tuple(amplitude.tolist()), tuple(phase.tolist()))


def compute_spectrum(values: Array, time: Array, frequency: Array) -> Lines:
    """Return the complex amplitude at each frequency [Hz]; whole periods, evenly sampled.

    `time` [s] is that of each value.
    """
    turns = np.exp(-2j * np.pi * np.outer(frequency, time))
    found: Lines = 2.0 / len(values) * turns @ values
    return found


def compute_hold(frequency: Array, dt: float) -> Lines:
    """Return what holding each sample for `dt` [s] does to a line: sinc and half a `dt` of lag."""
    found: Lines = np.sinc(frequency * dt) * np.exp(-1j * np.pi * frequency * dt)
    return found


class Response(NamedTuple):
    """Answer over input, a number a line, and its uncertainty."""

    value: Lines
    coherence: Array  # 1: all that was answered at this line was answered to this input
    distortion: float  # answer at lines not asked over answer at those asked, RMS


def estimate_response(excited: Lines, answer: Lines, others: Lines) -> Response:
    """Return the best linear approximation over several periods, shape (periods, lines).

    The coherence falls with noise, and with all that depends on the phases of the other lines.
    """
    cross = np.sum(answer * excited.conj(), axis=0)
    power, back = (np.sum(np.abs(x) ** 2, axis=0) for x in (excited, answer))
    coherence = np.abs(cross) ** 2 / np.maximum(power * back, np.finfo(float).tiny)
    distortion = float(np.sqrt(np.sum(np.abs(others) ** 2) / max(back.sum(), 1e-300)))
    return Response(cross / power, coherence, distortion)


RISE = 0.3  # [s] in which an input grows to its full amplitude


class Excitation(NamedTuple):
    """How the two inputs are made; the amplitudes are those of each line."""

    period: float = 2.0  # [s]
    harmonics: tuple[int, ...] = (1, 3, 5, 9, 15, 25, 41, 69, 99)
    speed: float = 0.004  # [m/s] of the tip that is asked for
    force: float = 0.25  # [N] at the tip
    settle: float = 2.0  # [s] before the first period that counts
    periods: int = 2  # that count
    draws: int = 2  # of phases

    @property
    def frequency(self) -> Array:
        """Of each line [Hz]."""
        return np.array(self.harmonics) / self.period


class Hybrid(NamedTuple):
    """Results of the experiments."""

    frequency: Array  # [Hz]
    h11: Response  # [N s/m]
    h12: Response
    h21: Response
    h22: Response  # [m/(N s)]


def measure_hybrid(
    build: Callable[[], System],
    excitation: Excitation,
    device: Device,
    position_scale: float,
    round_trip: float,
) -> Hybrid:
    """Return the parameters of the systems that `build` makes, each new and alike."""
    frequency = excitation.frequency
    moved, pushed = [], []
    for seed in range(excitation.draws):
        amplitude = excitation.speed / position_scale / (2.0 * np.pi * frequency)
        motion = draw_multisine(excitation.period, excitation.harmonics, amplitude, seed)
        moved += _run_periods(build(), excitation, device, round_trip, motion, None)
        even = np.full(len(frequency), excitation.force)
        force = draw_multisine(excitation.period, excitation.harmonics, even, seed)
        pushed += _run_periods(build(), excitation, device, round_trip, None, force)
    harmonics = np.arange(1, max(excitation.harmonics) + 2)
    is_excited = np.isin(harmonics, excitation.harmonics)
    every = harmonics / excitation.period
    ports = ([_compute_ports(record, every, device) for record in runs] for runs in (moved, pushed))
    of_moved, of_pushed = (_Ports(*map(np.array, zip(*periods, strict=True))) for periods in ports)

    def estimate(excited: Lines, answer: Lines) -> Response:
        return estimate_response(
            excited[:, is_excited], answer[:, is_excited], answer[:, ~is_excited]
        )

    return Hybrid(
        frequency,
        estimate(of_moved.v_hand, of_moved.f_hand),
        estimate(of_pushed.f_tip, of_pushed.f_hand),
        estimate(of_moved.v_hand, -of_moved.v_tip),
        estimate(of_pushed.f_tip, -of_pushed.v_tip),
    )


class _Ports(NamedTuple):
    """Both ports in one period, complex amplitudes."""

    v_hand: Lines
    f_hand: Lines
    v_tip: Lines
    f_tip: Lines


def _run_periods(
    system: System,
    excitation: Excitation,
    device: Device,
    round_trip: float,
    motion: Multisine | None,
    force: Multisine | None,
) -> list[RunData]:
    """Return the periods that count of one run."""
    begin = SETTLED + round_trip + 0.2

    def grow(signal: Multisine | None) -> Callable[[float], float]:
        if signal is None:
            return lambda _time: 0.0
        return lambda time: (
            min(max((time - begin) / RISE, 0.0), 1.0) * signal.at(time) if time > begin else 0.0
        )

    first = begin + RISE + round_trip + excitation.settle
    length = round(excitation.period / DT)
    record = run_hand(
        system,
        GuidedHand(grow(motion), device),
        first + excitation.periods * excitation.period,
        engage=SETTLED + round_trip,
        push=grow(force),
    )
    start = len(record.time) - excitation.periods * length
    return [
        cut_run(record, start + n * length, start + (n + 1) * length)
        for n in range(excitation.periods)
    ]


def _compute_ports(record: RunData, frequency: Array, device: Device) -> _Ports:
    s = 2j * np.pi * frequency
    v_hand = s * compute_spectrum(record.hand, record.time, frequency)
    rendered = compute_spectrum(record.force, record.time, frequency) * compute_hold(frequency, DT)
    later = record.time + DT / 2
    return _Ports(
        v_hand,
        (s * device.mass + device.damping) * v_hand - rendered,
        s * compute_spectrum(record.tip, later, frequency),
        compute_spectrum(record.load, later, frequency),
    )


# --- Llewellyn's criterion: whether a two-port is stable between any two passive ends
# It is, and only then, if at every frequency Re h11 >= 0, Re h22 >= 0 and
#
#     eta = (2 Re h11 Re h22 - Re(h12 h21)) / |h12 h21| >= 1
#
# (Llewellyn, "Some fundamental properties of transmission systems", Proc. IRE 40, 1952, 271-283;
# Adams & Hannaford, "Stable haptic interaction with virtual environments", IEEE Trans. Robotics and
# Automation 15, 1999, 465-474). It speaks of systems that are linear and do not change with time.
# An ideal teleoperator has eta = 1.


class Margin(NamedTuple):
    """Of each line."""

    eta: Array
    stable: NDArray[np.bool_]  # all three conditions hold


def compute_margin(two_port: Hybrid) -> Margin:
    """Return the criterion's numbers at each line of a two-port."""
    h11, h12, h21, h22 = (r.value for r in two_port[1:])
    through = h12 * h21
    eta = (2.0 * h11.real * h22.real - through.real) / np.abs(through)
    return Margin(eta, (h11.real >= 0.0) & (h22.real >= 0.0) & (eta >= 1.0))
