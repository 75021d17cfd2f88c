"""The `view:` section of a config file."""

import dataclasses
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class ViewRates:
    """How many messages a second of each topic are shown [Hz]; the newest is always among them.

    Topics not named here are slow and shown whole. A recording keeps every message.
    """

    command: float = 50.0
    state: float = 100.0
    tendons: float = 100.0
    hand: float = 100.0
    profile: float = 30.0  # of each tendon

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            rate = getattr(self, item.name)
            if not 1 <= rate <= 1000:
                raise ValueError(f"{item.name}: {rate:g} Hz is outside 1 to 1000 Hz")


@dataclass(frozen=True, slots=True)
class ViewConfig:
    """What the view shows, how often, and how much memory it may take."""

    rate_hz: ViewRates = field(default_factory=ViewRates)
    drain_hz: float = 25.0  # [Hz] how often the link is emptied and the sheath drawn
    curves_hz: float = (
        10.0  # [Hz] how often the curves over time grow: each growth of each costs 0.2 ms
    )
    file_period_s: float = 1.0  # [s] of data per block when only a file is written
    tension_scale_N: float = 20.0  # [N] the bright end of the colour scale  # noqa: N815
    window_s: float = 10.0  # [s] of the past in the curves over time
    tube_radius_m: float = 0.003  # [m] of a sheath as drawn
    tendon_spacing_m: float = 0.02  # [m] between the sheaths as drawn
    server_memory_mb: int = 512  # [MB] of the past kept for a browser that opens late
    web_port: int = 9090  # first choice; a free port is taken if it is in use
    grpc_port: int = 9876  # likewise
    directory: str = "recordings"  # where `--view rrd` saves without `--out`

    def __post_init__(self) -> None:
        for name, low, high, unit in (
            ("drain_hz", 1, 100, " Hz"),
            ("curves_hz", 1, 100, " Hz"),
            ("file_period_s", 0.05, 60, " s"),
            ("tension_scale_N", 0.1, 1e4, " N"),
            ("window_s", 0.5, 3600, " s"),
            ("tube_radius_m", 1e-4, 1, " m"),
            ("tendon_spacing_m", 1e-4, 10, " m"),
            ("server_memory_mb", 16, 65536, " MB"),
            ("web_port", 1024, 65535, ""),
            ("grpc_port", 1024, 65535, ""),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name}: {value:g}{unit} is outside {low:g} to {high:g}{unit}")
        if not self.directory:
            raise ValueError("directory: is empty, give a path (recordings)")
