"""Count how records that are of no tendon in a sheath end: none may have a wrong cause.

    python -m studies.hidden_effects.controls --seeds 1 2
    python -m studies.hidden_effects.controls --seeds 1 2 --tendons

With `--tendons` every effect of the catalogue, at both sizes, on each bench and with the housing's
channels alone too, is asked the same before any cause is searched: how far K is above the least,
and how much a mechanism without a sheath leaves. Half a second of a processor each.

Each mechanism with and without a load cell at its end, 30 s at 50 Hz, 0.02 N and 0.5 um of noise;
joints by torque and angle of the motor, with and without the link's angle, 5 mN m and 0.1 mrad. Of
odd seeds the motion is a sine, of even ones two of them. A record takes 5 to 60 s of a processor,
a joint up to 200 s.
"""

import itertools
import time
from collections import Counter
from typing import NamedTuple

import numpy as np
from scipy.signal import lsim

from estimator.diagnosis import report_text
from estimator.diagnosis.api import diagnose
from estimator.diagnosis.baseline import fit_baseline
from estimator.diagnosis.bench_units import compute_bench_scale, to_bench_units
from estimator.diagnosis.dataset import build_dataset
from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.record import RecordError, prepare_record
from estimator.diagnosis.simple_models import PLAIN_MECHANISMS, fit_simple_models
from estimator.measured_data import Samples
from estimator.units import LINEAR, ROTARY
from studies import hidden_effects
from studies.testbed.command import parse_options

RATE, DURATION = 50.0, 30.0
NOISE = {"tension": 0.02, "displacement": 5e-7}
ANGLE = 200.0  # [rad/m] of a motor's travel
ANGLE_NOISE = {"tension": 5e-3, "displacement": 1e-4}  # [N m], [rad]
REFUSED = "refused"


class Motion(NamedTuple):
    """The motor's motion."""

    time: np.ndarray  # [s]
    travel: np.ndarray  # [m]
    speed: np.ndarray  # [m/s]
    acceleration: np.ndarray  # [m/s2]


def move_motor(rng, *, sine):
    """Return a random motion from a sine, or from two of them."""
    t = np.arange(round(RATE * DURATION)) / RATE
    q, v, a = np.zeros((3, len(t)))
    for share in (1.0,) if sine else (1.0, 0.6):
        w = 2.0 * np.pi * rng.uniform(0.2, 0.7)
        amplitude, phase = share * rng.uniform(2e-3, 5e-3), rng.uniform(0.0, 2.0 * np.pi)
        q += amplitude * np.sin(w * t + phase)
        v += amplitude * w * np.cos(w * t + phase)
        a -= amplitude * w * w * np.sin(w * t + phase)
    return Motion(t, q - q.min(), v, a)


# --- tension at the motor and at the end of a mechanism [N]; stiffness is about 2 N/mm


def _pull_spring(motion, rng):
    end = 3.0 + rng.uniform(1500.0, 3000.0) * motion.travel
    return end, end


def _pull_damped_spring(motion, rng):
    tension, _ = _pull_spring(motion, rng)
    return tension + rng.uniform(30.0, 100.0) * (motion.speed + np.abs(motion.speed).max()), tension


def _pull_hardening_spring(motion, rng):
    end = 3.0 + 2000.0 * motion.travel * (1.0 + rng.uniform(0.2, 1.0) * motion.travel / 8e-3)
    return end, end


def _pull_softening_spring(motion, rng):
    end = 3.0 + 2.5e3 * motion.travel / (1.0 + rng.uniform(0.2, 0.6) * motion.travel / 8e-3)
    return end, end


def _turn_geared_joint(motion, rng):
    """A joint with inertia and friction behind a gear with play; effort of either sign."""
    q = motion.travel - motion.travel.mean()
    play = rng.uniform(1e-4, 5e-4)
    joint = np.empty_like(q)
    held = q[0]
    for i, x in enumerate(q):
        held = min(max(held, x - play), x + play)
        joint[i] = held
    load = 2000.0 * joint
    friction = rng.uniform(1.0, 3.0) * np.tanh(motion.speed / 1e-4)
    return load + friction + 0.5 * motion.acceleration, load


def _pull_damper(motion, rng):
    end = 12.0 + rng.uniform(400.0, 800.0) * motion.speed
    return end - end.min() + 1.0, end - end.min() + 1.0


def _swing_mass(motion, rng):
    """A mass that hangs; the travel counts as the refusal of the other sign says."""
    tension = rng.uniform(1.0, 3.0) * (9.81 - 60.0 * motion.acceleration)
    return tension - tension.min() + 1.0, tension - tension.min() + 1.0


def _pull_rubbing_cable(motion, rng):
    """Dry friction that no tension changes, risen to over 20 um."""
    tension, _ = _pull_spring(motion, rng)
    z, friction = 0.0, np.empty_like(tension)
    for i, step in enumerate(np.diff(motion.travel, prepend=motion.travel[0])):
        z = min(max(z + step, -2e-5), 2e-5)
        friction[i] = z / 2e-5
    return tension + rng.uniform(1.0, 2.5) * (1.0 + friction), tension


def _swing_on_cable(motion, rng):
    """A load of 1 kg that swings on a spring of 300 N/m."""
    w = np.sqrt(300.0 / 1.0)
    system = ([w * w], [1.0, 2.0 * rng.uniform(0.02, 0.1) * w, w * w])
    position = lsim(system, motion.travel, motion.time)[1]
    tension = 300.0 * (motion.travel - position)
    return tension - tension.min() + 2.0, tension - tension.min() + 2.0


def _read_broken_cell(motion, rng):
    end = np.full_like(motion.travel, rng.uniform(3.0, 20.0))
    return end, end


def _wander(motion, rng):
    walks = np.cumsum(rng.standard_normal((2, len(motion.time))), axis=1)
    return tuple(walk - walk.min() + 1.0 for walk in 0.3 * walks)


def _read_unrelated(motion, rng):
    other, third = (move_motor(rng, sine=False).travel for _ in range(2))
    return 1.0 + 2000.0 * other, 1.0 + 2000.0 * third


# --- torque of the motor [N m] and angle of a link [rad]; the motor turns by 1 to 3 rad


def _turn_angle(motion):
    """Return angle, speed and acceleration of the motor."""
    return (
        ANGLE * (motion.travel - motion.travel.mean()),
        ANGLE * motion.speed,
        ANGLE * motion.acceleration,
    )


def _turn_link_with_play(motion, rng):
    """A link on a spring behind a gear with play; dry friction and inertia on either side of it."""
    q, v, a = _turn_angle(motion)
    link, play = np.empty_like(q), rng.uniform(5e-3, 0.05)
    held = q[0]
    for i, x in enumerate(q):
        held = link[i] = min(max(held, x - play), x + play)
    friction = rng.uniform(0.1, 0.5) * np.tanh(v / 0.01)
    return 2.0 * link + friction + rng.uniform(0.005, 0.02) * a, link


def _turn_damped_spring(motion, rng):
    q, v, _ = _turn_angle(motion)
    return rng.uniform(1.0, 3.0) * q + rng.uniform(0.05, 0.3) * v, q


def _swing_link(motion, rng):
    """A link that hangs, with dry friction."""
    q, v, a = _turn_angle(motion)
    friction = rng.uniform(0.1, 0.5) * np.tanh(v / 0.01)
    return rng.uniform(1.0, 3.0) * (np.sin(q) + a / 40.0) + friction, q


TRUE_CAUSES = {"link with gravity and dry friction": "link_gravity"}
"""Of joints that a closed loop may be, what is named, with two rivals at most."""

JOINTS = {
    "link behind a gear with play": _turn_link_with_play,
    "spring with damper, by angle": _turn_damped_spring,
    "link with gravity and dry friction": _swing_link,
}

CONTROLS = {
    "spring": _pull_spring,
    "damped spring": _pull_damped_spring,
    "hardening spring": _pull_hardening_spring,
    "softening spring": _pull_softening_spring,
    "geared joint with play": _turn_geared_joint,
    "damper": _pull_damper,
    "mass": _swing_mass,
    "cable with friction of any load": _pull_rubbing_cable,
    "load that swings": _swing_on_cable,
    "broken load cell": _read_broken_cell,
    "random walk": _wander,
    "unrelated signals": _read_unrelated,
    **JOINTS,
}


def make_control(name, seed, *, tip):
    """Return noisy data of a mechanism, with a sensor at its end if `tip`."""
    rng = np.random.default_rng([seed, *name.encode()])
    motion = move_motor(rng, sine=seed % 2 == 1)
    effort, end = CONTROLS[name](motion, rng)
    is_joint = name in JOINTS
    travel = ANGLE * motion.travel if is_joint else motion.travel
    channels = {"proximal_tension": effort, "proximal_displacement": travel}
    channels |= {f"distal_{'displacement' if is_joint else 'tension'}": end} if tip else {}
    noise = ANGLE_NOISE if is_joint else NOISE
    noisy = {
        channel: y + noise[channel.partition("_")[2]] * rng.standard_normal(len(y))
        for channel, y in channels.items()
    }
    return Samples(motion.time, **noisy, units=ROTARY if is_joint else LINEAR)


class Result(NamedTuple):
    """What is said of a mechanism."""

    name: str
    verdict: str
    said: str
    named: tuple[str, ...] = ()  # the first cause, and its rivals

    @property
    def right(self):
        """Whether no cause is named, and no sheath either; or the true one among three."""
        is_open = self.verdict in (REFUSED, Verdict.UNEXPLAINED, Verdict.CHARACTERISED)
        return is_open or (len(self.named) < 4 and TRUE_CAUSES.get(self.name) in self.named)


def judge(name, seed, *, tip):
    """Make a record, diagnose it, and return what came of it."""
    try:
        found = diagnose(make_control(name, seed, tip=tip))
    except RecordError as error:
        return Result(name, REFUSED, str(error))
    named = (*found.causes, *found.ambiguous_with)
    return Result(name, found.verdict, report_text.format_verdict(found), named)


def judge_tendon(made, channels):
    """Return K of the base law, and the least error a mechanism leaves, in squares of the noise."""
    record = prepare_record(made.time, channels)
    dataset = build_dataset([to_bench_units(record, compute_bench_scale([record]))])
    mechanisms = fit_simple_models(dataset, PLAIN_MECHANISMS)
    left = min(m.held_out["proximal_tension"].mean_square for m in mechanisms)
    return fit_baseline(dataset).model.shared[0], left


def judge_tendons(seeds):
    """Print what would first be taken for no tendon among records of tendons."""
    found = []
    for seed, name, size in itertools.product(seeds, ("", *hidden_effects.EFFECTS), (1.0, 0.5)):
        for bench in hidden_effects.VISIBLE.get(name, ("blocked", "spring")):
            made = hidden_effects.make(
                seed, (name,) if name else (), size=size, bench=bench, duration=DURATION,
                rate=RATE, travel_noise=NOISE["displacement"],
            )  # fmt: skip
            every = dict(made.channels)
            housing = {key: y for key, y in every.items() if key.startswith("proximal")}
            case = name or "clean", bench, size, seed
            found += [(*judge_tendon(made, channels), *case) for channels in (every, housing)]
    print(f"{len(found)} records; of least K:", *min(found))
    print("of least error of a mechanism (noise is 1):", *min(found, key=lambda item: item[1]))


def main():
    """Judge every mechanism, and print what is said."""
    options = parse_options(
        __doc__, seeds=((1, 2), "of the records"), tendons=(False, "judge tendons instead")
    )
    if options.tendons:
        judge_tendons(options.seeds)
        return
    counts = Counter()
    for name in CONTROLS:
        for tip in (False, True):
            for seed in options.seeds:
                begin = time.process_time()
                result = judge(name, seed, tip=tip)
                counts[result.right] += 1
                print(
                    f"{name}, {'both ends' if tip else 'one end'}, {seed}: {result.verdict}"
                    f"{'' if result.right else ' WRONG'} ({time.process_time() - begin:.0f} s): "
                    f"{result.said}",
                    flush=True,
                )
    print(f"{counts[True]} of {sum(counts.values())} name no cause and no sheath, or the true one")


if __name__ == "__main__":
    main()
