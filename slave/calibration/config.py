"""Settings of the calibration procedure: tensions, speeds and limits."""

from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class KnownSheathConfig:
    """Known parameters of a sheath, from its supplier or a stiffness test."""

    length: float = 1.5  # [m]
    axial_stiffness: float | None = None  # EA [N] of tendon and sheath in series
    stiffness_error: float = 0.02  # relative standard uncertainty of EA/L

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not 0.0 < self.length <= 100.0:
            raise ValueError("length: must be above 0 and at most 100 m")
        if self.axial_stiffness is not None and not 1.0 <= self.axial_stiffness <= 1e9:
            raise ValueError("axial_stiffness: must be 1 to 1e9 N")
        if not 0.0 <= self.stiffness_error <= 1.0:
            raise ValueError("stiffness_error: must be 0 to 1")


@dataclass(frozen=True, slots=True)
class InitialiseConfig:
    """Tensions at the housing, tendon speeds at the motors, and abort limits."""

    at_start: bool = False  # run the quick procedure whenever the slave starts
    sheaths: tuple[KnownSheathConfig, ...] = ()  # one for each tendon, or one for all
    range: float | None = None  # [m] travel of every joint between its stops, where it is known
    range_error: float = 0.05  # allowed relative deviation of the measured range
    tension: float = 20.0  # [N] upper end of each loop, against the stop
    low: float = 0.2  # [N] lower end of each loop
    take_up: float = 0.5  # [N] in each tendon before and after the procedure
    keep: float = 0.2  # [N] in a tendon that the other one draws out
    seek_speed: float = 0.020  # [m/s] while the joint moves freely
    stretch_speed: float = 0.002  # [m/s] after first contact with the stop
    stretch_time: float = 3.0  # [s] of each later pull and release
    loops: int = 3  # pull-release loops after the first pull
    drags: int = 2  # drags after the loops: a draws b out, then b draws a; 1 or 2
    drag_time: float = 3.0  # [s] least duration of each
    gain_error: float = 0.002  # relative standard uncertainty of each load cell's gain
    pay_out: float = 0.0015  # [m] of the other tendon at the stop, so that it cannot pull
    slack_max: float = 0.005  # [m] wound in at most until the tendons of a joint are taut
    travel_max: float = 0.10  # [m] of a motor while seeking the stop
    compliance_max: float = 0.0005  # [m/N] largest compliance of a sheath; L/EA if EA is known
    lag_max: float = 0.003  # [m] largest tracking error of a motor
    phase_max: float = 30.0  # [s] timeout of each phase
    relax_max: float = 5.0  # [s] timeout for lowering the tensions after an abort

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        for name, low, high, unit in (
            ("tension", 2.0, 1000.0, "N"),
            ("low", 0.01, 10.0, "N"),
            ("take_up", 0.05, 10.0, "N"),
            ("keep", 0.05, 10.0, "N"),
            ("seek_speed", 1e-4, 1.0, "m/s"),
            ("stretch_speed", 1e-5, 0.1, "m/s"),
            ("stretch_time", 0.1, 60.0, "s"),
            ("drag_time", 0.1, 60.0, "s"),
            ("gain_error", 0.0, 1.0, "of the tension"),
            ("pay_out", 0.0, 0.1, "m"),
            ("slack_max", 1e-4, 1.0, "m"),
            ("travel_max", 1e-3, 10.0, "m"),
            ("compliance_max", 1e-7, 1.0, "m/N"),
            ("lag_max", 1e-4, 0.1, "m"),
            ("phase_max", 1.0, 3600.0, "s"),
            ("relax_max", 0.1, 60.0, "s"),
            ("range_error", 0.001, 1.0, "of the range"),
        ):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: must be {low:g} to {high:g} {unit}")
        if not 1 <= self.loops <= 10:
            raise ValueError("loops: must be 1 to 10")
        if self.drags not in (1, 2):
            raise ValueError("drags: must be 1 or 2")
        if self.range is not None and not 1e-3 <= self.range <= 10.0:
            raise ValueError("range: must be 0.001 to 10 m, or left out")
        if not max(self.low, self.take_up, self.keep) <= 0.25 * self.tension:
            raise ValueError("tension: must be four times low, take_up and keep, or more")

    def quick(self) -> "InitialiseConfig":
        """Return the settings of the quick procedure: one loop, less than 20 s per joint."""
        return replace(
            self,
            loops=1,
            drags=1,
            stretch_speed=1.5 * self.stretch_speed,
            stretch_time=0.5 * self.stretch_time,
            drag_time=0.5 * self.drag_time,
        )


def get_known_sheath(config: InitialiseConfig, tendon: int) -> KnownSheathConfig:
    """Return the known parameters of one tendon's sheath; the count was checked before."""
    if not config.sheaths:
        return KnownSheathConfig()
    return config.sheaths[tendon if len(config.sheaths) > 1 else 0]


def compute_compliance_limit(config: InitialiseConfig, tendon: int) -> float:
    """Return the largest possible e/T_in [m/N] at a stop: the frictionless L/EA.

    With a margin of 50 % if L and EA are known, so that a wrong EA does not hide a stop.
    """
    sheath = get_known_sheath(config, tendon)
    if sheath.axial_stiffness is None:
        return config.compliance_max
    return 1.5 * sheath.length / sheath.axial_stiffness
