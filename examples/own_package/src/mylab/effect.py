"""An effect of your own, for `teleop diagnose DATA --effects mylab-curve,creep`."""

from estimator.effects.effect import DISTAL_TENSION, Effect, Parameter, transform_channel

DISTAL_TENSION_CURVE = Effect(
    name="distal_tension_curve",
    cause="the load cell at the tip is not linear",
    equation="reading = T + curve T^2",
    parameters=(Parameter("curve", "1/N", low=-0.05, high=0.05, step=1e-3),),
    source="assumed range: 0.1 to 2 % of full scale",
    advice="Hang several known weights on the load cell at the tip, and keep the table.",
    starts=lambda _: [(2e-3,)],
    measure=lambda signals, values, _: transform_channel(
        signals, DISTAL_TENSION, lambda T: T + values[0] * T**2
    ),
    required_channels=frozenset({DISTAL_TENSION}),
)
