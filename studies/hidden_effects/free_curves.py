"""What no catalogue has: friction, or a reading, that follows one variable by any curve."""

import numpy as np

from studies.hidden_effects.effects import effect, vary

BY = {
    "outside:friction_over_position": "friction_by_position",
    "outside:friction_over_path": "friction_by_path",
    "outside:friction_over_rest": "friction_by_rest_time",
    "outside:friction_over_speed": "friction_by_speed",
    "outside:friction_over_cycle": "friction_by_phase",
    "outside:friction_over_temperature": "friction_by_temperature",
    "outside:curved_reading": "{channel}_by_reading",
    "outside:rough_spot": "friction_by_position",
}
"""What is to be found of each."""


def draw_curve(rng, height):
    """Return three waves over 0 to 1 whose farthest is `height` from their mean."""
    return {
        "height": vary(rng, height),
        "waves": rng.standard_normal(3) / (1.0, 1.5, 2.0),
        "shifts": rng.uniform(0.0, 2.0 * np.pi, 3),
    }


def evaluate_curve(height, waves, shifts, share, turns=0.5):
    def evaluate_waves(u):
        angles = 2.0 * np.pi * turns * np.multiply.outer(u, (1, 2, 3)) + shifts
        return np.sin(angles) @ waves

    grid = evaluate_waves(np.linspace(0.0, 1.0, 200))
    return height * (evaluate_waves(share) - grid.mean()) / np.abs(grid - grid.mean()).max()


def normalise(x):
    return (x - x.min()) / np.ptp(x)


def register_friction_over(name, variable):
    """Register friction that follows a variable, which is a function of time and motor travel."""

    def act(plant, **curve):
        plant.scales.append(
            lambda t, q: 1.0 + evaluate_curve(**curve, share=normalise(variable(t, q)))
        )

    act.__name__ = name
    effect("height", lambda r, _: draw_curve(r, 0.35), outside=True)(act)


register_friction_over("friction_over_position", lambda _t, q: q)
register_friction_over(
    "friction_over_path", lambda _t, q: np.cumsum(np.abs(np.diff(q, prepend=q[0])))
)


def compute_rest_time(t, q):
    """Return how long the motor has rested [s], and after it moves how long it had."""
    out, now, rests = np.zeros(len(t)), 0.0, True
    moves = np.abs(np.gradient(q)) > 0.02 * np.abs(np.gradient(q)).max()
    direction = 0.0
    for i in range(1, len(t)):
        if not moves[i]:
            now = now + t[i] - t[i - 1] if rests else 0.0
        elif np.sign(q[i] - q[i - 1]) == -direction and not rests:
            now = 0.0
        rests = not moves[i]
        direction = np.sign(q[i] - q[i - 1]) if moves[i] else 0.0
        out[i] = now
    return out


@effect("height", lambda r, _: {"height": vary(r, 0.5), "lasts": r.uniform(1.0, 3.0)}, outside=True)
def friction_over_rest(plant, height, lasts):
    plant.scales.append(
        lambda t, q: 1.0 + height * (1.0 - np.exp(-compute_rest_time(t, q) / lasts))
    )


@effect(
    "height",
    lambda r, _: {
        "height": vary(r, 0.5),
        "at": r.uniform(0.25, 0.5) * r.choice([-1.0, 1.0]),
        "width": vary(r, 0.15),
    },
    outside=True,
)
def friction_over_speed(plant, height, at, width):
    """In one direction, at about one speed, in shares of the highest."""

    def scale(t, q):
        v = np.gradient(q, t)
        return 1.0 + height * np.exp(-(((v / np.abs(v).max() - at) / width) ** 2))

    plant.scales.append(scale)


@effect("height", lambda r, _: draw_curve(r, 0.3) | {"period": r.uniform(3.0, 9.0)}, outside=True)
def friction_over_cycle(plant, period, **curve):
    plant.scales.append(lambda t, _q: 1.0 + evaluate_curve(**curve, share=t / period, turns=1.0))


@effect(
    "height",
    lambda r, s: draw_curve(r, 0.35) | {"swings": s.duration / r.uniform(15.0, 25.0)},
    outside=True,
)
def friction_over_temperature(plant, swings, **curve):
    def temperature(t):
        phase = 2.0 * np.pi * swings * t / t[-1]
        return 22.0 + 2.0 * np.sin(phase) + 1.2 * np.sin(2.7 * phase)

    plant.variables["temperature"] = temperature
    plant.scales.append(
        lambda t, _q: 1.0 + evaluate_curve(**curve, share=normalise(temperature(t)))
    )


@effect(
    "height",
    lambda r, _: (
        draw_curve(r, 0.4) | {"channel": str(r.choice(["proximal_tension", "distal_tension"]))}
    ),
    outside=True,
    read=True,
)
def curved_reading(plant, channel, **curve):
    plant.read(channel, lambda _t, y, _q: y + evaluate_curve(**curve, share=y / y.max()))
