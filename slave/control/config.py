"""The settings of the tendon controller."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ControlConfig:
    """Controller gains and limits, the same for each tendon of a rig."""

    compensation: float = 0.95  # g, fraction of the elongation that is compensated; 0 = none
    slack_side_tension: float = 0.3  # [N] at the housing, setpoint of the slack-side tendon
    slack_side_band: float = 0.05  # [N] dead band on either side of it
    slack_side_gain: float = 0.020  # [m/s/N] gain of the slack-side tension control
    tension_max: float = 20.0  # [N] at the housing; set it below the gate's
    limit_gain: float = 0.004  # [m/s/N] gain of the tension limit
    speed_max: float = 0.050  # [m/s] of a motor's tendon
    lead: float = 0.0125  # [s] velocity feedforward: lag of the servos

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        for name, least, most, unit in (
            ("compensation", 0.0, 1.0, ""),
            ("slack_side_tension", 0.0, 50.0, "N"),
            ("slack_side_band", 0.0, 50.0, "N"),
            ("slack_side_gain", 0.0, 1.0, "m/s/N"),
            ("tension_max", 0.1, 1000.0, "N"),
            ("limit_gain", 1e-5, 1.0, "m/s/N"),
            ("speed_max", 1e-4, 10.0, "m/s"),
            ("lead", 0.0, 0.1, "s"),
        ):
            if not least <= getattr(self, name) <= most:
                raise ValueError(f"{name}: must be {least:g} to {most:g} {unit}".rstrip())
        if self.compensation == 1.0:
            raise ValueError("compensation: must be below 1, or a blocked joint is wound up")
        if self.slack_side_band > self.slack_side_tension:
            raise ValueError("slack_side_band: must be at most slack_side_tension")
        if self.slack_side_tension + self.slack_side_band >= self.tension_max:
            raise ValueError("slack_side_tension: must be below tension_max")
