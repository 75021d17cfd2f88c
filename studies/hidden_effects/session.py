"""A record of a bench with hidden effects, made from a seed."""

import zlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from studies.hidden_effects import motion
from studies.hidden_effects.chain import (
    BLOCKED,
    SPRUNG,
    Law,
    Tip,
    build_line,
    build_resting_state,
    run,
)
from studies.hidden_effects.effects import EFFECTS, OUTSIDE, Plant, Scene, copy_plant
from studies.hidden_effects.sensors import measure_channel

CHANNELS = ("proximal_tension", "proximal_displacement", "distal_tension", "distal_displacement")
JUST_SEEN = {"tension": 0.02, "displacement": 4e-6}  # [N], [m]
ENOUGH = 6.0  # of which an effect changes some channel at full size, where it acts
MOST = 6.0  # by which a size may be enlarged for that


@dataclass(frozen=True)
class Hidden:
    """A record and its secret."""

    time: np.ndarray  # [s]
    channels: dict  # name -> readings [N], [m]
    truth: dict  # "sheath" and each effect -> its parameters
    heat: np.ndarray  # [J] of friction in the sheath since the start
    variables: dict  # name -> readings of further columns
    friction: np.ndarray  # in every sample, over that of the bench


@dataclass(frozen=True)
class Bench:
    """A clean bench: its sheath, its tip and what its motor does."""

    kind: str
    K: float
    L: float
    EA: float
    tip: Tip
    ways: motion.Schedule
    full: float
    time: np.ndarray

    def run(self, plant):
        """Return the true channels of a plant on this bench, and the heat [J]."""
        antagonist = None
        if plant.antagonist is not None:
            length, K, tension = plant.antagonist
            antagonist = ([(length, K)], tension)
        line = build_line(plant.sections, 1.0, self.EA, antagonist=antagonist)
        state = build_resting_state(line, plant.law, plant.tip, plant.pretension)
        t, zero = self.time, np.zeros(len(self.time))
        motor = motion.trace_motor(self.ways, t, state.x[0], plant.law.slack)
        scale = zero + 1.0
        for factor in plant.scales:
            scale = scale * factor(t, motor)
        growth = sum((grown(t) for grown in plant.growth), zero)
        wall = sum((moved(t) for moved in plant.wall), zero)
        outside = np.column_stack([motor, wall, scale, growth])
        out = run(line, plant.law, plant.tip, state, outside, t[1], plant.parts)
        return dict(zip(CHANNELS, out.T, strict=False)), out[:, 4]

    def read(self, plant, true):
        """Return what the sensors of a plant read, without noise."""
        readings = {}
        for channel, y in true.items():
            for function in plant.readings.get(channel, ()):
                y = function(self.time, y, true["proximal_displacement"])  # noqa: PLW2901
            readings[channel] = np.minimum(y, plant.ceilings.get(channel, np.inf))
        return readings


@lru_cache(maxsize=8)
def draw_bench(seed, kind, duration, rate):
    """Return the bench of a seed, its clean plant, and what that does: channels and heat."""
    rng = np.random.default_rng([seed, ("blocked", "spring").index(kind)])
    L, K, EA = rng.uniform(1.0, 2.0), rng.uniform(0.4, 1.6), rng.uniform(5e3, 15e3)
    tip, legs = Tip(BLOCKED), motion.draw_legs(rng)
    line = build_line([(L, K)], 1.0, EA)
    if kind == "spring":
        arrives = motion.compute_arriving_tension(line, tip)
        tip = Tip(SPRUNG, stiffness=arrives / rng.uniform(3e-3, 7e-3))
    ends, full = motion.rehearse_legs(line, tip, legs)
    ways = motion.build_schedule(legs, ends, full, duration)
    time = np.arange(round(duration * rate)) / rate
    there = Bench(kind, K, L, EA, tip, ways, full, time)
    clean = Plant([(L, K)], Law(), tip)
    return there, clean, *there.run(clean)


def make(
    seed,
    effects=("viscous_friction",),
    size=1.0,
    bench="blocked",
    channels=CHANNELS,
    duration=60.0,
    rate=100.0,
    noise=0.02,
    resolution=1.2e-7,
    travel_noise=0.0,
):
    """Return the record of a seed.

    `effects` are names of EFFECTS and OUTSIDE, or one of them; `noise` [N] is white, on the load
    cells; `resolution` [m] is that of the encoders, `travel_noise` [m] white noise on them.
    """
    effects = (effects,) if isinstance(effects, str) else tuple(effects)
    there, clean, true, heat = draw_bench(seed, bench, duration, rate)
    plant, physical = copy_plant(clean), False
    sheath = {"K": there.K, "EA": there.EA, "L": there.L, "k": there.tip.stiffness}
    truth = {"sheath": sheath}
    for name in effects:
        effect = (EFFECTS | OUTSIDE)[name]
        if bench not in effect.benches:
            raise ValueError(f"{name}: there is none on a bench with a {bench} tip")
        parameters = scale_parameters(effect, draw_effect(name, seed, bench, duration, rate), size)
        truth[name] = parameters | (effect.act(plant, **parameters) or {})
        physical |= not effect.read
    if physical:
        true, heat = there.run(plant)
    readings = there.read(plant, true)
    rng = np.random.default_rng([seed, zlib.crc32(repr(effects).encode())])
    seen = {}
    for channel in CHANNELS:
        kind = (
            {"noise": noise}
            if channel.endswith("tension")
            else {"noise": travel_noise, "resolution": resolution}
        )
        ceiling = plant.ceilings.get(channel, np.inf)
        y = measure_channel(rng, readings[channel], ceiling=ceiling, **kind)
        if channel in channels:
            seen[channel] = y
    further = {
        name: y(there.time) + 0.05 * rng.standard_normal(len(there.time))
        for name, y in plant.variables.items()
    }
    motor = true["proximal_displacement"]
    friction = np.ones_like(there.time)
    for factor in plant.scales:
        friction = friction * factor(there.time, motor)
    return Hidden(there.time, seen, truth, heat, further, friction)


def scale_parameters(effect, parameters, size):
    """Return the parameters of an effect with those that are its size multiplied."""
    return {n: v * size if n in effect.sized else v for n, v in parameters.items()}


@lru_cache(maxsize=128)
def draw_effect(name, seed, bench, duration, rate):
    """Return the parameters of an effect at full size, larger where it would hardly be seen.

    It changes some channel, where it acts, by several times what can just be seen.
    """
    there, clean, true, _ = draw_bench(seed, bench, duration, rate)
    scene = Scene(bench, duration, there.ways.holds, there.full, there.L, there.tip.stiffness, true)
    effect = (EFFECTS | OUTSIDE)[name]
    drawn = effect.draw(np.random.default_rng([seed, zlib.crc32(name.encode())]), scene)
    total = 1.0
    for _ in range(4):
        plant = copy_plant(clean)
        effect.act(plant, **scale_parameters(effect, drawn, total))
        changed = there.read(plant, true if effect.read else there.run(plant)[0])
        strength = compute_visibility(changed, true)
        if strength >= ENOUGH or total >= MOST:
            break
        total = min(MOST, total * 1.1 * ENOUGH / max(strength, 1.0))
    return scale_parameters(effect, drawn, total)


def compute_visibility(changed, true):
    """Return by how many times what can just be seen the channels differ, where they do."""
    most = 0.0
    for channel in CHANNELS:
        change = np.abs(changed[channel] - true[channel])
        if change.max() > 0.0:
            acting = change[change > 0.1 * change.max()]
            unit = JUST_SEEN[channel.split("_")[1]]
            most = max(most, float(np.sqrt(np.mean(acting**2)) / unit))
    return most
