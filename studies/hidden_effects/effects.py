"""What can be wrong with a bench: each effect changes the `Plant`, or how a channel is read.

An effect has parameters drawn at random around its full size, in SI units; those named in `sized`
grow with the size asked for and are 0 where there is no effect.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from studies.hidden_effects import sensors
from studies.hidden_effects.chain import Law, Tip

BENCHES = ("blocked", "spring")


class Scene(NamedTuple):
    """What an effect may look at when it is drawn."""

    bench: str
    duration: float  # [s]
    holds: list  # [(s, s)] while the motor rests under tension
    full: float  # [m] motor travel of a pull to 20 N
    length: float  # [m] of the sheath
    stiffness: float  # [N/m] of the tip's spring
    clean: dict  # channel -> true values without any effect


@dataclass
class Plant:
    """The bench before it runs: clean as made, then changed by effects."""

    sections: list  # (length [m], angle [rad])
    law: Law = field(default_factory=Law)
    tip: Tip = field(default_factory=Tip)
    pretension: float = 0.0  # [N]
    antagonist: tuple | None = None  # (length [m], friction coefficient * angle, tension [N])
    scales: list = field(default_factory=list)  # functions of time and motor travel
    growth: list = field(default_factory=list)  # strain, functions of time
    wall: list = field(default_factory=list)  # [m] functions of time
    parts: int = 1  # steps of a sample
    readings: dict = field(default_factory=dict)  # channel -> functions of sensors.py
    ceilings: dict = field(default_factory=dict)  # channel -> most that it reads, noise and all
    variables: dict = field(default_factory=dict)  # further column -> function of time

    def bend(self, parts=1, **changes):
        self.law = self.law._replace(**changes)
        self.parts = max(self.parts, parts)

    def read(self, channel, function):
        self.readings.setdefault(channel, []).append(function)


@dataclass(frozen=True)
class Effect:
    """How to draw an effect, which of its parameters are its size, and how it acts."""

    draw: Callable  # (rng, scene) -> parameters
    sized: tuple
    act: Callable  # (plant, **parameters) -> the same in other words, if any
    benches: tuple
    read: bool  # whether it acts on readings alone


EFFECTS: dict[str, Effect] = {}
OUTSIDE: dict[str, Effect] = {}


def effect(sized, draw, *, benches=BENCHES, read=False, outside=False):
    """Register a function as an effect by its own name."""

    def register(act):
        new = Effect(draw, tuple(sized.split()), act, benches, read)
        if outside:
            OUTSIDE["outside:" + act.__name__] = new
        else:
            EFFECTS[act.__name__] = new
        return act

    return register


def vary(rng, value):
    return value * rng.uniform(0.8, 1.2)


def vary_signed(rng, value):
    return vary(rng, value) * rng.choice([-1.0, 1.0])


def draw_time(rng, scene):
    return scene.duration * rng.uniform(0.2, 0.8)


# Friction


@effect("change", lambda r, s: {"change": vary_signed(r, 0.25), "time": draw_time(r, s)})
def friction_step(plant, change, time):
    plant.scales.append(lambda t, _q: 1.0 + change * (t >= time))


@effect("change", lambda r, _: {"change": vary_signed(r, 0.15)})
def friction_drift(plant, change):
    """`change` is that at the end."""
    plant.scales.append(lambda t, _q: 1.0 + change * t / t[-1])


@effect("drag", lambda r, _: {"drag": vary(r, 0.6)})
def constant_drag(plant, drag):
    plant.bend(drag=drag)


@effect("viscosity", lambda r, _: {"viscosity": vary(r, 500.0)})
def viscous_friction(plant, viscosity):
    plant.bend(parts=2, viscosity=viscosity)


@effect(
    "ratio", lambda r, s: {"ratio": vary(r, 0.25), "speed": vary(r, 0.2) * s.full, "memory": 0.2}
)
def stribeck_friction(plant, ratio, speed, memory):
    """Friction follows the speed a little late: without it a tendon would stick and slip."""
    plant.bend(parts=2, stribeck_ratio=ratio, stribeck_speed=speed, stribeck_memory=memory)


@effect("bristle", lambda r, _: {"bristle": vary(r, 5e-5)})
def presliding(plant, bristle):
    """`bristle` is what a contact gives at 10 N before it slides; its stiffness is constant."""
    plant.bend(bristle=bristle)


@effect("change", lambda r, _: {"change": vary_signed(r, 0.2)})
def direction_asymmetry(plant, change):
    """Friction towards the tip is 1 + change times that towards the housing."""
    plant.bend(asymmetry=1.0 + change)
    return {"ratio": 1.0 + change}


@effect("change", lambda r, _: {"change": -vary(r, 0.15)})
def tension_dependent_friction(plant, change):
    plant.bend(exponent=1.0 + change)
    return {"exponent": 1.0 + change}


@effect(
    "excess",
    lambda r, _: {"excess": vary(r, 0.3), "time": vary(r, 0.3), "distance": vary(r, 2e-5)},
)
def stick_slip(plant, excess, time, distance):
    """A contact at rest grows by `excess` with `time`; sliding `distance` undoes it."""
    plant.bend(parts=2, static_excess=excess, static_time=time, static_distance=distance)


# Elasticity and geometry


def draw_sections(rng, scene):
    count = rng.integers(2, 5)
    cuts = np.sort(rng.uniform(0.15, 0.85, count - 1))
    return {"spread": vary(rng, 1.5), "cuts": cuts, "order": rng.permutation(count)}


@effect("spread", draw_sections)
def nonuniform_curvature(plant, spread, cuts, order):
    """The sharpest section is exp(spread) times as sharp as the gentlest; `cuts` in lengths."""
    ((length, angle),) = plant.sections
    shares = np.diff([0.0, *cuts, 1.0])
    bends = shares * np.exp(spread * order / order.max())
    plant.sections = list(zip(length * shares, angle * bends / bends.sum(), strict=True))


@effect(
    "strain", lambda r, s: {"strain": vary(r, 1.5e-4) / s.length, "tension": r.uniform(1.0, 5.0)}
)
def nonlinear_stiffness(plant, strain, tension):
    plant.bend(toe_strain=strain, toe_tension=tension)


@effect("share", lambda r, _: {"share": vary(r, 0.1), "time": vary(r, 8.0)})
def creep(plant, share, time):
    plant.bend(creep_share=share, creep_time=time)


@effect(
    "compression", lambda r, _: {"compression": vary(r, 5e-7), "threshold": r.uniform(0.0, 5.0)}
)
def sheath_compression(plant, compression, threshold):
    plant.bend(compression=compression, compression_threshold=threshold)


@effect("length", lambda r, _: {"length": vary(r, 5e-4)})
def slack(plant, length):
    plant.bend(slack=length)


def draw_growth(rng, scene):
    return {"growth": vary(rng, 1e-4), "time": rng.choice([np.inf, scene.duration / 3])}


@effect("growth", draw_growth)
def thermal_expansion(plant, growth, time):
    """The tendon is `growth` longer at the end: evenly, or exponentially with `time`."""
    length = sum(length for length, _ in plant.sections)

    def strain(t):
        grown = t / t[-1] if np.isinf(time) else np.expm1(-t / time) / np.expm1(-t[-1] / time)
        return growth / length * grown

    plant.growth.append(strain)


# Ends of the tendon


def draw_pretension(rng, scene):
    """Less than what pulls bring to the tip, or there would be none there but by letting go."""
    return {"tension": vary(rng, min(6.0, 0.6 * scene.clean["distal_tension"].max()))}


@effect("tension", draw_pretension)
def pretension(plant, tension):
    plant.pretension = tension


@effect("width", lambda r, _: {"width": vary(r, 1e-4)}, benches=("spring",), read=True)
def joint_backlash(plant, width):
    plant.read("distal_displacement", lambda _t, y, _q: sensors.apply_play(y, width))


@effect("friction", lambda r, _: {"friction": vary(r, 0.5)}, benches=("spring",))
def joint_friction(plant, friction):
    plant.tip = plant.tip._replace(friction=friction)


@effect(
    "tension",
    lambda r, _: {"tension": vary(r, 0.2), "K": r.uniform(0.5, 1.5)},
    benches=("spring",),
)
def antagonist_tension(plant, tension, K):
    """A second tendon through a sheath of its own, held with `tension` at its housing."""
    ((length, _),) = plant.sections[:1]
    plant.antagonist = (length, K, tension) if tension > 0.0 else None


@effect(
    "stiffness",
    lambda r, s: {
        "stiffness": vary(r, 3.0) * s.stiffness,
        "travel": r.uniform(0.3, 0.7) * s.clean["distal_displacement"].max(),
    },
    benches=("spring",),
)
def tip_contact(plant, stiffness, travel):
    plant.tip = plant.tip._replace(stop=travel, stop_stiffness=stiffness)
    ratio = stiffness / plant.tip.stiffness
    return {"hardness": ratio / (1.0 + ratio)}


@effect(
    "damping mass",
    lambda r, s: {
        "damping": vary(r, 0.06) * s.stiffness,
        "mass": s.stiffness / vary(r, 25.0) ** 2,
    },
    benches=("spring",),
)
def tip_inertia(plant, damping, mass):
    plant.tip = plant.tip._replace(damping=damping, mass=mass)
    plant.parts = max(plant.parts, 4)


def draw_visit(rng, scene):
    """Move the tip in one of the motor's holds."""
    start, end = scene.holds[rng.integers(len(scene.holds))]
    begin = rng.uniform(start + 0.1 * (end - start), start + 0.4 * (end - start))
    ramp = rng.uniform(0.2, 1.0)
    back = np.inf if rng.random() < 0.5 else begin + ramp + rng.uniform(1.0, 2.5)
    return {"travel": vary_signed(rng, 6e-4), "time": begin, "ramp": ramp, "back": back}


@effect("travel", draw_visit)
def tip_moved(plant, travel, time, ramp, back):
    """Blocked: the wall moves; spring: its far end."""

    def wall(t):
        return travel * (np.clip((t - time) / ramp, 0, 1) - np.clip((t - back) / ramp, 0, 1))

    plant.wall.append(wall)


# Sensors


def register_cell_effects(side, gain, bias, drift):
    """Register gain, bias and drift of the load cell at one end."""
    channel = side + "_tension"

    def register(what, name, value, make):
        def act(plant, **parameters):
            plant.read(channel, make(*parameters.values()))

        act.__name__ = f"{channel}_{what}"
        effect(name, lambda r, _: {name: vary_signed(r, value)}, read=True)(act)

    register("gain", "gain", gain, sensors.build_gain)
    register("bias", "bias", bias, sensors.build_bias)
    register("drift", "drift", drift, sensors.build_drift)


register_cell_effects("proximal", 0.06, 0.4, 0.6)
register_cell_effects("distal", 0.05, 0.3, 0.5)


def list_encoders(scene):
    """Encoders that move: that of a blocked tip does not."""
    both = ["proximal_displacement", "distal_displacement"]
    return both if scene.bench == "spring" else both[:1]


def draw_lag(rng, scene):
    channel = rng.choice(["proximal_tension", "distal_tension", *list_encoders(scene)])
    kind = rng.choice(["delay", "filter"])
    return {"lag": vary(rng, 0.06), "channel": str(channel), "kind": str(kind)}


@effect("lag", draw_lag, read=True)
def sensor_lag(plant, lag, channel, kind):
    plant.read(channel, sensors.build_delay(lag) if kind == "delay" else sensors.build_filter(lag))


def draw_ceiling(rng, scene):
    channel = str(rng.choice(["proximal_tension", "distal_tension"]))
    return {"depth": vary(rng, 0.2), "peak": scene.clean[channel].max(), "channel": channel}


@effect("depth", draw_ceiling, read=True)
def saturation(plant, depth, peak, channel):
    limit = (1.0 - depth) * peak
    plant.ceilings[channel] = limit
    return {"limit": limit}


@effect(
    "gain",
    lambda r, s: {"gain": vary_signed(r, 0.04), "channel": str(r.choice(list_encoders(s)))},
    benches=("spring",),  # with a blocked tip it is a stiffer tendon
    read=True,
)
def encoder_scale(plant, gain, channel):
    plant.read(channel, sensors.build_gain(gain))


@effect(
    "slip",
    lambda r, s: {
        "slip": vary_signed(r, 8e-5),
        "time": draw_time(r, s),
        "channel": str(r.choice(list_encoders(s))),
    },
    read=True,
)
def encoder_slip(plant, slip, time, channel):
    plant.read(channel, sensors.build_slip(slip, time))


def draw_ripple(rng, amplitude, order):
    """Over less than a turn only a wave near its crest is more than another radius."""
    crest = rng.choice([0.5, 1.5]) * np.pi
    return {
        "amplitude": vary(rng, amplitude),
        "radius": rng.uniform(5e-3, 15e-3),
        "order": order,
        "phase": crest + rng.uniform(-0.6, 0.6),
    }


@effect(
    "amplitude",
    lambda r, _: draw_ripple(r, 2e-4, 1),
    benches=("spring",),  # over the short travel of a blocked tip it is a stiffer tendon
    read=True,
)
def pulley_eccentricity(plant, **ripple):
    plant.read("proximal_displacement", sensors.build_wave(**ripple))


@effect("amplitude", lambda r, _: draw_ripple(r, 0.2, int(r.integers(10, 61))), read=True)
def cogging_ripple(plant, **ripple):
    plant.read("proximal_tension", sensors.build_wave(**ripple))


@effect("force", lambda r, _: {"force": vary(r, 0.3), "give": vary(r, 2e-5)}, read=True)
def sheath_rub(plant, force, give):
    plant.read("proximal_tension", sensors.build_rub(force, give))


# Outside the catalogue


def draw_walk(rng, spread):
    """Return a random walk of 60 places whose farthest is 1."""
    walk = np.cumsum(rng.standard_normal(60))
    walk -= walk.mean()
    return {"spread": vary(rng, spread), "walk": walk / np.abs(walk).max()}


def interpolate_walk(walk, t):
    return np.interp(t, np.linspace(0.0, t[-1], len(walk)), walk)


@effect("spread", lambda r, _: draw_walk(r, 0.3), outside=True)
def wandering_friction(plant, spread, walk):
    plant.scales.append(lambda t, _q: 1.0 + spread * interpolate_walk(walk, t))


@effect("spread", lambda r, _: draw_walk(r, 0.1), outside=True, read=True)
def wandering_gain(plant, spread, walk):
    plant.read("proximal_tension", lambda t, y, _q: y * (1.0 + spread * interpolate_walk(walk, t)))


@effect(
    "height",
    lambda r, s: {
        "height": vary(r, 0.5),
        "place": s.full * r.uniform(0.3, 0.8),
        "width": s.full * vary(r, 0.08),
    },
    outside=True,
)
def rough_spot(plant, height, place, width):
    plant.scales.append(lambda _t, q: 1.0 + height * np.exp(-(((q - place) / width) ** 2)))


@effect(
    "amplitude",
    lambda r, _: {
        "amplitude": vary(r, 0.3),
        "period": r.uniform(0.8, 3.0),
        "shape": r.standard_normal((3, 2)),
        "channel": str(r.choice(["proximal_tension", "distal_tension"])),
    },
    outside=True,
    read=True,
)
def periodic_disturbance(plant, amplitude, period, shape, channel):
    def disturbed(t, y, _q):
        angle = 2 * np.pi * t / period * np.arange(1, 4)[:, None]
        waves = shape[:, 0] @ np.sin(angle) + shape[:, 1] @ np.cos(angle)
        return y + amplitude * waves / np.abs(shape).sum() * 2

    plant.read(channel, disturbed)


def copy_plant(plant):
    """Return a copy that effects may change."""
    lists = {n: list(getattr(plant, n)) for n in ("scales", "growth", "wall")}
    readings = {channel: list(functions) for channel, functions in plant.readings.items()}
    dicts = {"ceilings": dict(plant.ceilings), "variables": dict(plant.variables)}
    return replace(plant, readings=readings, **dicts, **lists)
