"""Settings of the calibration procedure: tensions, speeds and limits."""

from dataclasses import dataclass, replace

from teleop.config.ranges import RangedConfig, build_ranged_field, check_ranges


@dataclass(frozen=True, slots=True)
class KnownSheathConfig(RangedConfig):
    """Known parameters of a sheath, from its supplier or a stiffness test."""

    length: float = build_ranged_field(1.5, 0.0, 100.0, "m", above=True)  # of the sheath
    # EA [N] of tendon and sheath in series
    axial_stiffness: float | None = build_ranged_field(None, 1.0, 1e9, "N")
    # relative standard uncertainty of EA/L
    stiffness_error: float = build_ranged_field(0.02, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class InitialiseConfig:
    """Tensions at the housing, tendon speeds at the motors, and abort limits."""

    at_start: bool = False  # run the quick procedure whenever the slave starts
    sheaths: tuple[KnownSheathConfig, ...] = ()  # one for each tendon, or one for all
    # travel between the stops, where it is known: of every joint, or a list with one for each
    range: float | tuple[float, ...] | None = build_ranged_field(None, 1e-3, 10.0, "m")
    # allowed relative deviation of the measured range
    range_error: float = build_ranged_field(0.05, 0.001, 1.0, "of the range")
    # upper end of each loop, against the stop
    tension: float = build_ranged_field(20.0, 2.0, 1000.0, "N")
    low: float = build_ranged_field(0.2, 0.01, 10.0, "N")  # lower end of each loop
    # in each tendon before and after the procedure
    take_up: float = build_ranged_field(0.5, 0.05, 10.0, "N")
    # in a tendon that the other one draws out
    keep: float = build_ranged_field(0.2, 0.05, 10.0, "N")
    seek_speed: float = build_ranged_field(0.020, 1e-4, 1.0, "m/s")  # while the joint moves freely
    # after first contact with the stop
    stretch_speed: float = build_ranged_field(0.002, 1e-5, 0.1, "m/s")
    stretch_time: float = build_ranged_field(3.0, 0.1, 60.0, "s")  # of each later pull and release
    loops: int = build_ranged_field(3, 1, 10)  # pull-release loops after the first pull
    # after the loops: a draws b out, then b draws a
    drags: int = build_ranged_field(2, 1, 2)
    drag_time: float = build_ranged_field(3.0, 0.1, 60.0, "s")  # least duration of each
    # relative standard uncertainty of each load cell's gain
    gain_error: float = build_ranged_field(0.002, 0.0, 1.0, "of the tension")
    # of the other tendon at the stop, so that it cannot pull
    pay_out: float = build_ranged_field(0.0015, 0.0, 0.1, "m")
    # wound in at most until the tendons of a joint are taut
    slack_max: float = build_ranged_field(0.005, 1e-4, 1.0, "m")
    # of a motor while seeking the stop
    travel_max: float = build_ranged_field(0.10, 1e-3, 10.0, "m")
    # largest compliance of a sheath; L/EA if EA is known
    compliance_max: float = build_ranged_field(0.0005, 1e-7, 1.0, "m/N")
    lag_max: float = build_ranged_field(0.003, 1e-4, 0.1, "m")  # largest tracking error of a motor
    phase_max: float = build_ranged_field(30.0, 1.0, 3600.0, "s")  # timeout of each phase
    # timeout for lowering the tensions after an abort
    relax_max: float = build_ranged_field(5.0, 0.1, 60.0, "s")

    def __post_init__(self) -> None:
        check_ranges(self)
        if not max(self.low, self.take_up, self.keep) <= 0.25 * self.tension:
            raise ValueError("tension: must be four times low, take_up and keep, or more")

    def to_quick(self) -> "InitialiseConfig":
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


def get_known_range(config: InitialiseConfig, joint: int) -> float | None:
    """Return the known travel of one joint [m], if any; the count was checked before."""
    return config.range[joint] if isinstance(config.range, tuple) else config.range
