"""The settings of the tendon controller."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ControlConfig:
    """How the joints of one rig are driven, the same for each of its tendons."""

    compensation: float = 0.95  # g, share of the elongation that the motor makes up for; 0 = none
    slack_side_tension: float = 0.3  # [N] at the housing, kept on the tendon that does not drive
    slack_side_band: float = 0.05  # [N] to either side of it, within which nothing is done
    slack_side_gain: float = 0.020  # [m/s/N] with which it is paid out, or reeled in
    tension_max: float = 20.0  # [N] at the housing; set it below the gate's
    limit_gain: float = 0.004  # [m/s/N] with which that is approached, and given way to
    speed_max: float = 0.050  # [m/s] of a motor's tendon
    lead: float = 0.0125  # [s] by which a moving command is led: how far the servos lag

    def __post_init__(self) -> None:
        """Refuse what cannot be stable, or slackens a tendon."""
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
