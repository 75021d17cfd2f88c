"""Adaptation of K to a sheath that moves: random sheaths, hands and changes of friction.

python -m studies.adaptation                     40 single tendons against a spring, seeds from 100
python -m studies.adaptation --unchanged         the same without a change, with other disturbances
python -m studies.adaptation --pair              the tendons of as many pairs
python -m studies.adaptation --loop --settle 3   with a sensing loop in each tube, after 3 s
python -m studies.adaptation --tip               the bend at the tip changes, no other
python -m studies.adaptation --unchanged --wrong 0.3   K calibrated 30 % too high
python -m studies.adaptation --pair --spring 300 pairs whose joint has a return spring [N/m]

The plant is the simulated rig's chain of springs and Coulomb nodes, which knows nothing of the
adaptation. A sheath keeps its shape for `CHANGE_S` of use, then the friction of all or of one bend
changes by -40 to +60 %, within 0.1 to 20 s. T_out is scored over `AFTER_S` from `--settle` after
the change on, with the fixed K and with adaptation. Seeds 0 to 99 were used for tuning. Takes 7
minutes.
"""

from typing import NamedTuple

import numpy as np

from estimator.adaptation import run_adapting
from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.law.sheath import Section, Sheath
from estimator.online import online
from estimator.online.online import Estimates, TendonModel
from estimator.pair_adaptation import run_adapting_pair
from estimator.structs import to_struct
from slave.rigs.simulated import JointConfig, TendonPlantConfig, build_joint
from slave.sheath_section import SectionConfig
from slave.simulation.environment import TissueConfig
from slave.simulation.joint import (
    BodyConfig,
    Joint,
    JointState,
    advance_joint,
    compute_truth,
    init_joint,
)
from slave.simulation.sensing_loop import SensingLoopConfig, build_loop, compute_loop_target
from slave.simulation.tendon import NEUTRAL, SheathConfig, TendonDeviations, divide_sheath
from studies.testbed.command import parse_options
from teleop.coupling.force_attenuation import ConfidenceConfig, attenuate_force

RATE = 500.0  # [Hz]
CHANGE_S, SETTLE_S, AFTER_S = 25.0, 30.0, 15.0  # [s]
COEFFICIENT_MAX = 2.0  # of friction: a sheath with less bend for its K is drawn again
LOOP_FRICTION = 1 / 3  # coefficient of a sensing loop over that of the tendon
EARLY_S = 8.0  # [s]
NOISE_N, NOISE_M = 0.02, 1e-6
DRIFT_S = 1200.0  # [s] period of drifts
CONFIDENCE = to_struct(ConfidenceConfig())
TENSION_MAX, KEPT = 16.0, 0.6  # [N] at which a pull stops; of the tendon that is drawn out


class Use(NamedTuple):
    """A joint in use."""

    models: tuple[TendonModel, ...]  # as calibrated before the change
    time: Array  # [s] shape (n,)
    tension: Array  # T_in [N] with noise, shape (n, tendons)
    travel: Array  # q_p [m] with noise
    tip: Array  # T_out [N]
    loop: Array | None  # tensions of sensing loops with noise [N], shape (n, tendons, ends)
    change_end: float  # [s] when the friction has changed
    K_after: tuple[float, ...]  # of each tendon


def generate_hand(rng: np.random.Generator, duration: float) -> Array:
    """Return the speed [m/s] of a hand: reaches, palpation, grasps, rests, tremor throughout."""
    speed = np.zeros(round(duration * RATE))
    t = np.arange(len(speed)) / RATE
    i, position = round(1.0 * RATE), 0.0
    while i < len(speed):
        kind = rng.choice(["reach", "reach", "palpate", "grasp", "rest"])
        last = round(rng.uniform(0.5, 2.5) * RATE)
        span = t[:last]
        if kind in ("reach", "grasp"):
            goal = rng.uniform(-0.009, 0.009) if kind == "reach" else 0.011 * rng.choice([-1, 1])
            share = span / max(span[-1], 1e-9)
            piece = (goal - position) * 30.0 * (share * (1.0 - share)) ** 2 / max(span[-1], 1e-9)
            position = goal
        elif kind == "palpate":
            amplitude, rate = rng.uniform(5e-4, 2.5e-3), rng.uniform(0.6, 2.5)
            periods = max(1, round(span[-1] * rate))
            rate = periods / span[-1]
            piece = amplitude * 2.0 * np.pi * rate * np.sin(2.0 * np.pi * rate * span)
            piece -= piece.mean()
        else:
            piece = np.zeros(last)
        end = min(i + last, len(speed))
        speed[i:end] = piece[: end - i]
        i = end
    rate = rng.uniform(7.0, 11.0)
    tremor = rng.uniform(0.0, 4e-5) * 2.0 * np.pi * rate * np.sin(2.0 * np.pi * rate * t)
    return np.where(t > 1.0, speed + tremor, 0.0)


@jit_compile
def run_plant(
    joint: Joint,
    state: JointState,
    before: tuple[Array, Array],
    change: tuple[Array, Array],
    begin: float,
    grow: float,
    hand: Array,
    dt: float,
) -> Array:
    """Return the truth (time, channel, tendon) of a joint that a hand moves.

    From `begin` on and within `grow` [s] the friction of each node goes from `before` by the
    relative `change`. The pulled motor follows the hand, up to a tension; the other one pays out.
    """
    n = len(hand)
    out = np.empty((n, 4, 2))
    targets = np.zeros(2)
    truth = compute_truth(joint, state)
    for k in range(n):
        for i in range(2):
            if i == 1 and not joint.pair:
                continue
            step = (1.0 - 2.0 * i) * hand[k]
            T = truth[0, i]
            if joint.pair:
                if step <= 0.0:
                    step = step + min(max(0.015 * (KEPT - T), -0.05), 0.05)
                elif T > TENSION_MAX:
                    step = 0.0
            elif (T > TENSION_MAX and step > 0.0) or (T < KEPT and step < 0.0):
                step = 0.0
            targets[i] += step * dt
        share = min(max((k * dt - begin) / grow, 0.0), 1.0)
        joint.a.chain.friction[:] = before[0] * (1.0 + share * change[0])
        if joint.pair:
            joint.b.chain.friction[:] = before[1] * (1.0 + share * change[1])
        state = advance_joint(joint, state, targets, 1, dt)
        truth = compute_truth(joint, state)
        out[k] = truth
    return out


@jit_compile
def run_loop(
    loop: Joint,
    state: JointState,
    before: Array,
    change: Array,
    begin: float,
    grow: float,
    motion: Array,
    dt: float,
) -> Array:
    """Return the tensions at the ends of a sensing loop [N], shape (n, 2); see `run_plant`."""
    out, targets = np.empty((len(motion), 2)), np.zeros(2)
    for k in range(len(motion)):
        share = min(max((k * dt - begin) / grow, 0.0), 1.0)
        loop.a.chain.friction[:] = before * (1.0 + share * change)
        targets[0] = motion[k]
        state = advance_joint(loop, state, targets, 1, dt)
        out[k] = compute_truth(loop, state)[::2, 0]
    return out


def generate_sheath(rng: np.random.Generator) -> tuple[tuple[SectionConfig, ...], float, float]:
    """Return random sections, K and EA [N]: uneven bends, a straight stretch now and then."""
    while True:
        sections, K, EA = _draw_sheath(rng)
        bend = sum(s.length / s.radius for s in sections)
        if COEFFICIENT_MAX * bend >= K:
            return sections, K, EA


def _draw_sheath(rng: np.random.Generator) -> tuple[tuple[SectionConfig, ...], float, float]:
    count = int(rng.integers(1, 5))
    length = rng.uniform(0.2, 0.5, count) * rng.uniform(0.8, 1.2)
    radius = np.exp(rng.uniform(np.log(0.05), np.log(0.4), count))
    sections = [SectionConfig(float(x), float(r)) for x, r in zip(length, radius, strict=True)]
    if rng.random() < 0.3:
        sections.insert(int(rng.integers(0, count + 1)), SectionConfig(0.2))
    return tuple(sections), float(rng.uniform(0.4, 1.8)), float(rng.uniform(6e3, 15e3))


class Conditions(NamedTuple):
    """What happens in a use, and what disturbs it."""

    changes: bool = True  # the friction changes
    at_tip: bool = False  # only that of the last bend
    has_loops: bool = False  # there is a sensing loop in each tube
    settle: float = SETTLE_S  # [s] from the change on before T_out is scored
    after: float = AFTER_S  # [s] for which it is scored
    deviations: TendonDeviations = NEUTRAL  # of the tendons
    backlash: float = 0.0  # [m] of the joint
    spring: float = 0.0  # [N/m] of the joint of a pair
    tissue: TissueConfig | None = None  # None: random
    model_error: float = 0.0  # of K in the model, relative
    drift: float = 0.0  # [N] amplitude of the zero of each load cell
    expansion: float = 0.0  # [m] amplitude of each tendon's length


ORDINARY = Conditions()


def simulate_use(seed: int, pair: bool, given: Conditions = ORDINARY) -> Use:
    """Return a random joint in use."""
    rng = np.random.default_rng(seed)
    tendons, models, K_after = [], [], []
    loops: list[tuple[Joint, Array]] = []
    before: list[Array] = []
    change: list[Array] = []
    whole = rng.random() < 0.5 and not given.at_tip
    factor = rng.uniform(-0.4, 0.6)
    for _ in range(2 if pair else 1):
        sections, K, EA = generate_sheath(rng)
        bend = sum(s.length / s.radius for s in sections)
        config = SheathConfig(sections, K / bend, EA, 40)
        tendons.append(TendonPlantConfig(config))
        rows = tuple(Section(s.length, s.radius) for s in sections)
        sheath = Sheath(rows, K / bend * (1.0 + given.model_error), EA)
        loop_friction = 2.0 * LOOP_FRICTION * K if given.has_loops else 0.0
        models.append(TendonModel(sheath, NOISE_N, NOISE_M, loop_friction=loop_friction))
        cell, phi = divide_sheath(config)
        before.append(config.friction * phi)
        edges = np.cumsum([s.length for s in sections])
        where = np.searchsorted(edges, np.cumsum(cell) - 0.5 * cell)
        bends = [n for n, s in enumerate(sections) if np.isfinite(s.radius)]
        bend = bends[-1] if given.at_tip else rng.choice(bends)
        hit = np.full(len(cell), True) if whole else where == bend
        moved = given.changes and (len(change) == 0 or rng.random() < 0.5)
        change.append(np.where(hit, factor, 0.0) * float(moved))
        K_after.append(float((before[-1] * (1.0 + change[-1])).sum()))
        loop = build_loop(SensingLoopConfig(LOOP_FRICTION * config.friction), config)
        loops.append((loop, change[-1]))
    spring = given.spring if pair else float(rng.uniform(200.0, 1000.0))
    body = BodyConfig(
        friction=float(rng.uniform(0.0, 0.3)),
        spring=spring,
        pretension=1.0 if pair else 4.0,
        backlash=given.backlash,
    )
    stiffness = float(np.exp(rng.uniform(np.log(300), np.log(3e4))))
    depth = float(rng.uniform(0.001, 0.006))
    tissue = given.tissue or TissueConfig(position=depth, stiffness=stiffness, exponent=1.0)
    joint = build_joint(JointConfig(tuple(tendons), body, tissue))
    joint = joint._replace(
        a=joint.a._replace(chain=joint.a.chain._replace(deviations=given.deviations)),
        b=joint.b._replace(chain=joint.b.chain._replace(deviations=given.deviations)),
    )
    grow = float(np.exp(rng.uniform(np.log(0.1), np.log(20.0))))
    hand = generate_hand(rng, CHANGE_S + grow + given.settle + given.after)
    both = (before[0], before[-1]), (change[0], change[-1])
    truth = run_plant(joint, init_joint(joint), *both, CHANGE_S, grow, hand, 1.0 / RATE)[
        :, :, : len(tendons)
    ]
    shape, time = truth[:, 0].shape, np.arange(len(hand)) / RATE
    phase = np.random.default_rng([seed, 1]).uniform(0.0, 2.0 * np.pi, shape[1])
    wave = np.sin(2.0 * np.pi * time[:, None] / DRIFT_S + phase)
    T = truth[:, 0] + given.drift * wave + rng.normal(0.0, NOISE_N, shape)
    q = truth[:, 1] + given.expansion * wave + rng.normal(0.0, NOISE_M, shape)
    motion = np.array([compute_loop_target(SensingLoopConfig(), t) for t in time])
    ends = [
        run_loop(
            loop, init_joint(loop), loop.a.chain.friction.copy(), np.append(half, half[::-1]),
            CHANGE_S, grow, motion, 1.0 / RATE,
        )
        for loop, half in loops * given.has_loops
    ]  # fmt: skip
    return Use(
        tuple(models),
        time,
        T,
        q,
        truth[:, 2],
        np.stack(ends, 1) + rng.normal(0.0, NOISE_N, (*shape, 2)) if given.has_loops else None,
        CHANGE_S + grow,
        tuple(K_after),
    )


def render(run: Estimates) -> Array:
    """Return the force [N] that reaches the hand, before it is scaled."""
    T_out = run.distal_tension
    rows = zip(T_out, run.low, run.high, T_out - run.adapted_low, strict=True)
    return np.array([attenuate_force(CONFIDENCE, *row) for row in rows])


class Scores(NamedTuple):
    """Figures of one tendon, with the fixed K and with adaptation."""

    is_changed: bool
    error: Array  # relative to full scale, percentiles 50, 90, 99, shape (2, 3)
    within: Array  # share of time within 5 % of full scale, shape (2,)
    inside: Array  # share of all time inside the interval, shape (2,)
    rendered: Array  # mean of the force in the hand over that of T_out, before the change and late
    excess: Array  # of the force in the hand over T_out: largest; time above 2 %, shape (2, 2)
    K_error: Array  # relative, where scoring begins and at the end
    is_adapted: bool
    is_false: bool  # adapted before the change


def score_use(use: Use, settle: float = SETTLE_S) -> list[Scores]:
    """Return the figures of the tendons of a joint in use, from `settle` [s] after the change."""
    T, q = (np.ascontiguousarray(rows.T) for rows in (use.tension, use.travel))
    if len(use.models) == 2:
        models = use.models[0], use.models[1]
        runs = run_adapting_pair(models, use.time, use.tension, use.travel, use.loop)
    else:
        loop = None if use.loop is None else use.loop[:, 0]
        runs = (run_adapting(use.models[0], use.time, T[0], q[0], loop),)
    early = (use.time > EARLY_S) & (use.time < CHANGE_S)
    late, out = use.time > use.change_end + settle, []
    for k, (model, run) in enumerate(zip(use.models, runs, strict=True)):
        tip, K = use.tip[:, k], use.K_after[k]
        both = online.run(online.prepare(model), use.time, T[k], q[k]), run.estimates
        errors = [abs(r.distal_tension - tip)[late] / tip.max() for r in both]
        felt = [render(r) for r in both]
        excess = [(f - tip)[use.time > EARLY_S] / tip.max() for f in felt]
        scores = Scores(
            abs(K / model.sheath.K - 1.0) > 0.01,
            np.array([np.percentile(e, [50, 90, 99]) for e in errors]),
            np.array([np.mean(e < 0.05) for e in errors]),
            np.array([np.mean((r.low <= tip + 1e-6) & (tip <= r.high)) for r in both]),
            np.array([[f[w].sum() / tip[w].sum() for w in (early, late)] for f in felt]),
            np.array([[e.max(), np.mean(e > 0.02)] for e in excess]),
            run.K[late][[0, -1]] / K - 1.0,
            run.adapted_from >= 0,
            run.adapted_from >= 0 and bool(use.time[run.adapted_from] < CHANGE_S),
        )
        out.append(scores)
    return out


UNCHANGED = Conditions(changes=False)
DISTURBED = (
    UNCHANGED,
    UNCHANGED._replace(deviations=TendonDeviations(creep_share=0.05, creep_time=8.0)),
    UNCHANGED._replace(backlash=5e-4),
    UNCHANGED._replace(deviations=TendonDeviations(presliding=2e-5)),
    UNCHANGED._replace(drift=0.05),
    UNCHANGED._replace(expansion=1e-4),
    UNCHANGED._replace(tissue=TissueConfig(position=0.001, stiffness=900.0, dissipation=20.0)),
)


def main() -> None:
    """Print the figures."""
    options = parse_options(
        __doc__,
        sheaths=(40, "number of them"),
        first=(100, "first seed"),
        unchanged=(False, "no change of friction, but something else that disturbs"),
        settle=(SETTLE_S, "time after the change before T_out is scored [s]"),
        loop=(False, "a sensing loop in each tube"),
        tip=(False, "the bend at the tip changes"),
        minutes=(AFTER_S / 60.0, "time of use that is scored"),
        pair=(False, "both tendons of pairs; those that stay the same are reported apart"),
        spring=(0.0, "of the joint of a pair [N/m]"),
        wrong=(0.0, "relative error of the calibrated K"),
    )
    scores = []
    for k in range(options.sheaths):
        conditions = DISTURBED[k % len(DISTURBED)] if options.unchanged else ORDINARY
        conditions = conditions._replace(
            at_tip=options.tip,
            has_loops=options.loop,
            settle=options.settle,
            after=60.0 * options.minutes,
            spring=options.spring,
            model_error=options.wrong,
        )
        use = simulate_use(options.first + k, options.pair, conditions)
        scores += score_use(use, options.settle)
    for is_changed in (True, False):
        report([s for s in scores if s.is_changed is is_changed], is_changed)


def report(scores: list[Scores], is_changed: bool) -> None:
    """Print the figures of those tendons that changed, or of those that did not."""
    if not scores:
        return
    print(f"{len(scores)} tendons {'that changed' if is_changed else 'unchanged'}; adapted: "
          f"{sum(s.is_adapted for s in scores)}, of them before the change: "
          f"{sum(s.is_false for s in scores)}")  # fmt: skip
    errors_K = 100.0 * np.abs([s.K_error for s in scores]).T
    for when, errors in zip(("where scoring begins", "at the end"), errors_K, strict=True):
        print(f"|error of K| {when}, percentiles 50, 90, 100: "
              f"{np.percentile(errors, [50, 90, 100]).round(1)} %")  # fmt: skip
    for i, name in enumerate(("fixed K", "adapted")):
        error = 100.0 * np.mean([s.error[i] for s in scores], axis=0)
        within = np.array([s.within[i] for s in scores])
        inside = [s.inside[i] for s in scores]
        print(
            f"{name}: error of T_out, mean of percentiles 50, 90, 99: {error.round(1)} %; within "
            f"5 %: {within.mean():.1%} of time, 90 % of time in {np.mean(within >= 0.9):.0%} of "
            f"tendons; inside the interval {np.mean(inside):.2%}, least {np.min(inside):.2%}; "
            "in the hand, before the change and late: "
            f"{100.0 * np.mean([s.rendered[i] for s in scores], axis=0).round(2)} % of T_out; more "
            f"by {max(s.excess[i, 0] for s in scores):.1%} of full scale at most, by 2 % in "
            f"{np.mean([s.excess[i, 1] for s in scores]):.2%} of time"
        )


if __name__ == "__main__":
    main()
