"""Tensions behind passed joints and joint torques of random arms, against the brute-force chain.

    python -m studies.routing [--arms 20] [--seed 0]

Each tendon of an arm is a chain of Coulomb beads through its sheath and over the guides of all
joints that it passes (studies.brute_force.routed). Housing tension and joint angles move at random:
apart and together, fast and slow, back and forth, and by so little that the tendon sticks.

Two figures of each arm. Tensions: the model of the passed joints alone, given the tension at the
sheath's end. Torques: sheaths and passed joints together, from the tension at the housing with
noise, and joint angles with an error. Beside them what leaving out passed friction costs. Takes
2 minutes.
"""

from dataclasses import dataclass, replace

import numpy as np

from estimator.law.sheath import Section, Sheath
from estimator.routing import tensions
from estimator.routing.routing import Routing, RoutingError, prepare
from studies.brute_force.routed import Bend, Pin, RoutedChain
from studies.testbed.command import parse_options

PRETENSION = 5.0  # [N] uniform, at the start
TENSION_RANGE = (2.0, 15.0)  # [N] at the housing
ANGLE_RANGE = 0.6  # [rad]
TENSION_NOISE = 0.02  # [N]
DEAD_BAND = 2 * TENSION_NOISE
ANGLE_ERROR = 5e-5  # [rad] largest: encoders of 16 bits


@dataclass(frozen=True)
class Arm:
    """An arm for the model, and its tendons for the chain."""

    routing: Routing
    guides: list[list[Pin | Bend]]
    sheaths: list[Sheath]


@dataclass(frozen=True)
class Motion:
    """What the chains say, over the samples of a motion."""

    angles: np.ndarray  # (n, joints)
    T_in: np.ndarray  # (n, tendons)
    q_p: np.ndarray
    T_out: np.ndarray  # at the end of the sheath
    tensions: np.ndarray  # (n, tendons, joints), NaN where a tendon does not pass
    torque: np.ndarray  # (n, joints)


def make_arm(rng: np.random.Generator, pitch: float = 1.0 / 20, beads: int = 24) -> Arm:
    """Return a random arm of two or three joints, `pitch` [rad] between beads on pins."""
    for _ in range(1000):
        joints = int(rng.integers(2, 4))
        signs = rng.choice([-1.0, 1.0], (joints, joints)) * np.tri(joints)
        if rng.random() < 0.5:
            signs = np.vstack([signs, -signs])  # antagonistic pairs
        else:
            signs = np.vstack([signs, rng.choice([-1.0, 1.0], (1, joints))])
        radii = signs * rng.uniform(0.003, 0.008, signs.shape)
        is_last = np.arange(joints) == (signs != 0).cumsum(axis=1).argmax(axis=1)[:, None]
        kinds = rng.choice(["proximal", "distal", "spread"], signs.shape)
        kinds[is_last] = "proximal"
        is_bend = kinds == "spread"
        wrap = np.where(is_bend, rng.uniform(-0.4, 0.4, signs.shape),
                        rng.uniform(1.0, 1.8, signs.shape))  # fmt: skip
        side = np.where(is_bend, rng.choice([-1.0, 1.0], signs.shape), -np.sign(radii))
        friction = np.where(is_last, 0.0, rng.uniform(0.05, 0.25, signs.shape))
        stiffness = rng.uniform(6e3, 2e4)
        try:
            routing = Routing(
                radii, friction * (signs != 0), wrap * (signs != 0), side, kinds,
                rng.uniform(0.02, 0.05, signs.shape), rng.uniform(0.03, 0.05, signs.shape),
                stiffness,
            )  # fmt: skip
        except RoutingError:
            continue
        guides = [
            [_make_guide(routing, tendon, joint, pitch, beads) for joint in order]
            for tendon, order in enumerate(routing.order)
        ]
        sheaths = [
            Sheath((Section(0.4, rng.uniform(0.06, 0.3)), Section(0.4, rng.uniform(0.06, 0.3))),
                   0.08, stiffness)
            for _ in guides
        ]  # fmt: skip
        return Arm(routing, guides, sheaths)
    raise AssertionError("no arm could be balanced")


def _make_guide(routing: Routing, tendon: int, joint: int, pitch: float, beads: int) -> Pin | Bend:
    arm, friction, wrap, side, span, length = (
        float(table[tendon, joint])
        for table in (routing.radii, routing.friction, routing.wrap, routing.side, routing.span,
                      routing.length)
    )  # fmt: skip
    if routing.guide[tendon, joint] == "spread":
        return Bend(joint, arm, friction, wrap, span, length, side, beads)
    on_distal_link = routing.guide[tendon, joint] == "distal"
    return Pin(joint, arm, friction, wrap, span, on_distal_link, 1.0 / pitch)


def make_motion(rng: np.random.Generator, tendons: int, joints: int, legs: int) -> np.ndarray:
    """Return housing tensions [N] and joint angles [rad], shape (n, tendons + joints)."""
    state, rows = np.array([PRETENSION] * tendons + [0.0] * joints), []
    for leg in range(legs):
        target = state.copy()
        kind = leg % 6
        if kind in (0, 2, 3):  # tensions
            target[:tendons] = rng.uniform(*TENSION_RANGE, tendons)
        if kind in (1, 2):  # all joints
            target[tendons:] = rng.uniform(-ANGLE_RANGE, ANGLE_RANGE, joints)
        elif kind in (3, 4):  # joints by so little that much sticks
            small = target[tendons:] + rng.normal(0.0, 2e-3 if kind == 3 else 3e-4, joints)
            target[tendons:] = np.clip(small, -ANGLE_RANGE, ANGLE_RANGE)
        elif kind == 5:  # one joint
            target[tendons + rng.integers(joints)] = rng.uniform(-ANGLE_RANGE, ANGLE_RANGE)
        samples = int(rng.choice([25, 40, 70]))
        for part in np.arange(1, samples + 1) / samples:
            rows.append(state + part * (target - state))  # noqa: PERF401
        state = target
    return np.array(rows)


def play_motion(arm: Arm, rows: np.ndarray, sheath_beads: int = 40) -> Motion:
    """Return what chains of all tendons say."""
    tendons, joints = arm.routing.radii.shape
    n = len(rows)
    q_p, T_out = np.empty((n, tendons)), np.empty((n, tendons))
    behind, torque = np.full((n, tendons, joints), np.nan), np.zeros((n, joints))
    for t, (guides, sheath) in enumerate(zip(arm.guides, arm.sheaths, strict=True)):
        sections = [(section.length, section.radius) for section in sheath.sections]
        chain = RoutedChain(
            sections, sheath.friction, sheath.axial_stiffness, guides, np.zeros(joints),
            PRETENSION, beads=sheath_beads,
        )  # fmt: skip
        passed = [guide.joint for guide in guides]
        for i, row in enumerate(rows):
            chain.move_to(row[t], row[tendons:])
            q_p[i, t], T_out[i, t] = chain.motor_travel, chain.sheath_end_tension
            behind[i, t, passed] = chain.guide_tensions
            torque[i] += chain.torque(joints)
    return Motion(rows[:, tendons:], rows[:, :tendons], q_p, T_out, behind, torque)


@dataclass(frozen=True)
class Comparison:
    """Error over full scale, largest and mean, and what part lay inside the interval."""

    worst: float
    mean: float
    inside: float
    worst_without: float  # friction of the passed joints left out of the model
    mean_without: float

    def __str__(self) -> str:
        return (
            f"largest error {self.worst:6.2%}, mean {self.mean:6.3%}, inside {self.inside:7.2%}"
            f"; without passed friction {self.worst_without:6.1%}, {self.mean_without:6.2%}"
        )


def compare_tensions(arm: Arm, motion: Motion) -> Comparison:
    """Compare tensions behind all passed joints, given those at the ends of the sheaths."""
    full_scale = np.nanmax(motion.tensions, axis=(0, 2), keepdims=True)
    ends = (motion.T_out,) * 3
    with_friction = run_model(arm.routing, ends, motion.angles)
    without = run_model(replace(arm.routing, friction=0.0), ends, motion.angles)
    return _compare(with_friction[:3], without[0], motion.tensions, full_scale)


def compare_torques(arm: Arm, motion: Motion, rng: np.random.Generator) -> Comparison:
    """Compare joint torques, from housing tension with noise and joint angles with an error."""
    T_in = motion.T_in + rng.normal(0.0, TENSION_NOISE, motion.T_in.shape)
    angles = motion.angles + rng.uniform(-ANGLE_ERROR, ANGLE_ERROR, motion.angles.shape)
    for i in range(1, len(T_in)):  # dead band: a peak of noise would be kept (theory, section 9)
        T_in[i] = np.clip(T_in[i - 1], T_in[i] - DEAD_BAND, T_in[i] + DEAD_BAND)
    ends = (T_in, T_in - DEAD_BAND - 4 * TENSION_NOISE, T_in + DEAD_BAND + 4 * TENSION_NOISE)
    routing = replace(arm.routing, angle_error=ANGLE_ERROR)
    with_friction = run_model(routing, ends, angles, arm.sheaths)
    without = run_model(replace(routing, friction=0.0), ends, angles, arm.sheaths)
    full_scale = np.abs(motion.torque).max(axis=0)
    return _compare(with_friction[3:], without[3], motion.torque, full_scale)


def run_model(
    routing: Routing,
    ends: tuple[np.ndarray, ...],
    angles: np.ndarray,
    sheaths: list[Sheath] | None = None,
) -> list[np.ndarray]:
    """Return the fields of `JointTensions` over the samples."""
    prepared = prepare(routing, sheaths)
    state = tensions.build_initial_state(prepared, PRETENSION, np.zeros(angles.shape[1]))
    rows = []
    for T, low, high, theta in zip(*ends, angles, strict=True):
        estimate, state = tensions.step(prepared, state, T, low, high, theta)
        rows.append(estimate)
    return [np.array(column) for column in zip(*rows, strict=True)]


def _compare(
    model: list[np.ndarray], without: np.ndarray, truth: np.ndarray, full_scale: np.ndarray
) -> Comparison:
    value, low, high = model
    error = np.abs(value - truth) / full_scale
    error_without = np.abs(without - truth) / full_scale
    rounding = 1e-6 * full_scale
    inside = (low - rounding <= truth) & (truth <= high + rounding) | np.isnan(truth)
    return Comparison(
        float(np.nanmax(error)), float(np.nanmean(error)), float(inside.mean()),
        float(np.nanmax(error_without)), float(np.nanmean(error_without)),
    )  # fmt: skip


def main() -> None:
    options = parse_options(
        __doc__,
        arms=(20, "number of arms"),
        seed=(0, "of the first arm"),
        legs=(12, "motions of each"),
    )
    for seed in range(options.seed, options.seed + options.arms):
        rng = np.random.default_rng(seed)
        arm = make_arm(rng)
        shape = arm.routing.radii.shape
        motion = play_motion(arm, make_motion(rng, *shape, options.legs))
        print(f"arm {seed}, {shape[0]} tendons, {shape[1]} joints, {len(motion.T_in)} samples")
        print(f"  tensions: {compare_tensions(arm, motion)}")
        print(f"  torques:  {compare_torques(arm, motion, rng)}", flush=True)


if __name__ == "__main__":
    main()
