"""The `view:` section of a config file."""

import math
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from teleop.config.ranges import MAY_BE_INFINITE, RangedConfig, build_ranged_field, check_ranges
from teleop.messages.topics import COMMAND, HAND, LEDGER, STATE, TENDONS, TOPICS, Topic

Layout = Literal["surgeon", "experiment", "presentation"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)


def _build_rate(default: float) -> Any:
    return build_ranged_field(default, 1.0, 1000.0, "Hz")


@dataclass(frozen=True, slots=True)
class ViewRates(RangedConfig):
    """Display rates of the topics [Hz].

    Other topics are slow and shown completely. A recording keeps every message. A topic that is to
    be shown more often than by default is received completely, which takes some 5 % of a processor.
    """

    command: float = _build_rate(COMMAND.sampled_hz)  # setpoints of the tips
    state: float = _build_rate(STATE.sampled_hz)  # joints and their forces
    tendons: float = _build_rate(TENDONS.sampled_hz)  # tensions and displacements
    hand: float = _build_rate(HAND.sampled_hz)  # force on the hand
    ledger: float = _build_rate(LEDGER.sampled_hz)  # energies of each side
    profile: float = _build_rate(8.0)  # of each tendon: tube, T(x) and X'
    levers: float = _build_rate(8.0)  # joint, hand and their forces in the scene
    loop: float = _build_rate(30.0)  # pieces of each hysteresis loop


@dataclass(frozen=True, slots=True)
class ViewConfig:
    """Content, rates and memory of the view."""

    layout: Layout = "experiment"  # panels of the view, and their sizes
    rate_hz: ViewRates = field(default_factory=ViewRates)
    # rate of reading the link and updating the scene
    drain_hz: float = build_ranged_field(8.0, 1, 100, "Hz")
    # rate of extending curves and loops: 0.2 ms for each curve
    curves_hz: float = build_ranged_field(4.0, 1, 100, "Hz")
    # of a processor; both are slower where they would take more
    processor_share: float = build_ranged_field(0.25, 0.01, 1)
    # of data per block when only a file is written
    file_period_s: float = build_ranged_field(1.0, 0.05, 60, "s")
    # the bright end of the colour scale
    tension_scale_N: float = build_ranged_field(20.0, 0.1, 1e4, "N")  # noqa: N815
    # on the hand, drawn as long as tension_scale_N at the tip
    hand_scale_N: float = build_ranged_field(4.0, 0.01, 1e4, "N")  # noqa: N815
    # of the past in the curves over time
    window_s: float = build_ranged_field(10.0, 0.5, 3600, "s")
    # of the past in the hysteresis loop
    loop_window_s: float = build_ranged_field(30.0, 0.5, 3600, "s")
    # by which each section's bend leaves the last plane
    bend_planes: tuple[float, ...] = build_ranged_field((), -math.tau, math.tau, "rad")
    environment_m: tuple[float, ...] = field(  # [m] travel of each joint at contact
        default=(), metadata=MAY_BE_INFINITE
    )
    # of the pulley a joint is drawn on: angle = travel / radius
    joint_radius_m: float = build_ranged_field(0.012, 1e-4, 10, "m")
    # of the circle the hand is drawn on
    hand_radius_m: float = build_ranged_field(0.05, 1e-4, 10, "m")
    # of the size of the scene; radius of a sheath where its tendon slides
    tube_radius: float = build_ranged_field(0.012, 1e-4, 0.1)
    # of the size of the scene, between sheaths
    tendon_spacing: float = build_ranged_field(0.05, 1e-3, 1)
    # of history for a page that is opened later: half a minute
    server_memory_mb: int = build_ranged_field(8, 4, 65536, "MB")
    # memory of the viewer, in a browser or a window
    page_memory_mb: int = build_ranged_field(1024, 256, 4000, "MB")
    # preferred port; a free one if it is in use
    web_port: int = build_ranged_field(9090, 1024, 65535)
    foxglove: bool = False  # also serve the messages to the Foxglove app, on this machine
    foxglove_port: int = build_ranged_field(8765, 1024, 65535)  # preferred port, as above
    directory: str = "recordings"  # folder of `--view rrd` without `--out`

    def list_sampled_topics(self) -> frozenset[Topic[Any]]:
        """Return the topics of which copies of some messages are enough for what is shown."""
        return frozenset(
            t for t in TOPICS if getattr(self.rate_hz, t.name, math.inf) <= t.sampled_hz
        )

    def __post_init__(self) -> None:
        check_ranges(self)
        for i, travel in enumerate(self.environment_m):
            if math.isnan(travel) or travel == -math.inf:
                raise ValueError(f"environment_m.{i}: a travel [m], or .inf for none")
        if not self.directory:
            raise ValueError("directory: is empty, give a path (recordings)")
