"""The `view:` section of a config file."""

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from teleop.config.loading import MAY_BE_INFINITE
from teleop.messages.topics import COMMAND, HAND, LEDGER, STATE, TENDONS, TOPICS, Topic

Layout = Literal["surgeon", "experiment", "presentation"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)


@dataclass(frozen=True, slots=True)
class ViewRates:
    """Display rates of the topics [Hz].

    Other topics are slow and shown completely. A recording keeps every message. A topic that is to
    be shown more often than by default is received completely, which takes some 5 % of a processor.
    """

    command: float = COMMAND.sampled_hz  # [Hz] setpoints of the tips
    state: float = STATE.sampled_hz  # [Hz] joints and their forces
    tendons: float = TENDONS.sampled_hz  # [Hz] tensions and displacements
    hand: float = HAND.sampled_hz  # [Hz] force on the hand
    ledger: float = LEDGER.sampled_hz  # [Hz] energies of each side
    profile: float = 8.0  # [Hz] of each tendon: tube, T(x) and X'
    levers: float = 8.0  # [Hz] joint, hand and their forces in the scene
    loop: float = 30.0  # [Hz] pieces of each hysteresis loop

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            rate = getattr(self, item.name)
            if not 1 <= rate <= 1000:
                raise ValueError(f"{item.name}: {rate:g} Hz is outside 1 to 1000 Hz")


@dataclass(frozen=True, slots=True)
class ViewConfig:
    """Content, rates and memory of the view."""

    layout: Layout = "experiment"  # panels of the view, and their sizes
    rate_hz: ViewRates = field(default_factory=ViewRates)
    drain_hz: float = 8.0  # [Hz] rate of reading the link and updating the scene
    curves_hz: float = 4.0  # [Hz] rate of extending curves and loops: 0.2 ms for each curve
    processor_share: float = 0.25  # of a processor; both are slower where they would take more
    file_period_s: float = 1.0  # [s] of data per block when only a file is written
    tension_scale_N: float = 20.0  # [N] the bright end of the colour scale  # noqa: N815
    hand_scale_N: float = 4.0  # [N] on the hand, drawn as long as tension_scale_N at the tip  # noqa: N815
    window_s: float = 10.0  # [s] of the past in the curves over time
    loop_window_s: float = 30.0  # [s] of the past in the hysteresis loop
    bend_planes: tuple[float, ...] = ()  # [rad] by which each section's bend leaves the last plane
    environment_m: tuple[float, ...] = field(  # [m] travel of each joint at contact
        default=(), metadata=MAY_BE_INFINITE
    )
    joint_radius_m: float = 0.012  # [m] of the pulley a joint is drawn on: angle = travel / radius
    hand_radius_m: float = 0.05  # [m] of the circle the hand is drawn on
    # of the size of the scene; radius of a sheath where its tendon slides
    tube_radius: float = 0.012
    tendon_spacing: float = 0.05  # of the size of the scene, between sheaths
    server_memory_mb: int = 8  # [MB] of history for a page that is opened later: half a minute
    page_memory_mb: int = 1024  # [MB] memory of the viewer, in a browser or a window
    web_port: int = 9090  # preferred port; a free one if it is in use
    foxglove: bool = False  # also serve the messages to the Foxglove app, on this machine
    foxglove_port: int = 8765  # preferred port, as above
    directory: str = "recordings"  # folder of `--view rrd` without `--out`

    def sampled(self) -> frozenset[Topic[Any]]:
        """Return the topics of which copies of some messages are enough for what is shown."""
        return frozenset(
            t for t in TOPICS if getattr(self.rate_hz, t.name, math.inf) <= t.sampled_hz
        )

    def __post_init__(self) -> None:
        for name, low, high, unit in (
            ("drain_hz", 1, 100, " Hz"),
            ("curves_hz", 1, 100, " Hz"),
            ("processor_share", 0.01, 1, ""),
            ("file_period_s", 0.05, 60, " s"),
            ("tension_scale_N", 0.1, 1e4, " N"),
            ("hand_scale_N", 0.01, 1e4, " N"),
            ("window_s", 0.5, 3600, " s"),
            ("loop_window_s", 0.5, 3600, " s"),
            ("joint_radius_m", 1e-4, 10, " m"),
            ("hand_radius_m", 1e-4, 10, " m"),
            ("tube_radius", 1e-4, 0.1, ""),
            ("tendon_spacing", 1e-3, 1, ""),
            ("server_memory_mb", 4, 65536, " MB"),
            ("page_memory_mb", 256, 4000, " MB"),
            ("web_port", 1024, 65535, ""),
            ("foxglove_port", 1024, 65535, ""),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name}: {value:g}{unit} is outside {low:g} to {high:g}{unit}")
        for i, angle in enumerate(self.bend_planes):
            if not abs(angle) <= math.tau:
                raise ValueError(f"bend_planes.{i}: {angle:g} rad is outside -6.28 to 6.28 rad")
        for i, travel in enumerate(self.environment_m):
            if math.isnan(travel) or travel == -math.inf:
                raise ValueError(f"environment_m.{i}: a travel [m], or .inf for none")
        if not self.directory:
            raise ValueError("directory: is empty, give a path (recordings)")
