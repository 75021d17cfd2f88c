"""The `impair` section: defects of a proxy between master and slave."""

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from teleop.config.ranges import RangedConfig, build_ranged_field, check_ranges
from teleop.errors import UsageError
from teleop.link.config import LinkConfig


@dataclass(frozen=True, slots=True)
class DirectionConfig:
    """Impairments of one direction.

    A burst of losses is a Gilbert-Elliott channel (Gilbert 1960, Elliott 1963): its bad state lasts
    `burst_length` messages on average and loses `burst_depth` of them; its frequency is such that
    `burst_loss` of all messages are lost.
    """

    delay: float = build_ranged_field(0.0, 0.0, 10.0, "s")  # mean delay of a message
    jitter: float = 0.0  # [s] the delay wanders from delay - jitter to delay + jitter
    # [s] between random delays, linear in between; 0 = a new one each message
    jitter_time: float = 0.1
    loss: float = build_ranged_field(0.0, 0.0, 1.0)  # share of messages lost independently
    burst_loss: float = build_ranged_field(0.0, 0.0, 1.0)  # share of messages lost in bursts
    # messages a burst lasts on average
    burst_length: float = build_ranged_field(20.0, 1.0, 1e6, "messages")
    # share of messages lost during a burst
    burst_depth: float = build_ranged_field(1.0, 0.0, 1.0, above=True)
    # share of messages held back, so that others overtake them
    reorder: float = build_ranged_field(0.0, 0.0, 1.0)
    reorder_by: float = build_ranged_field(0.003, 0.0, 10.0, "s")  # additional delay of those
    duplicate: float = build_ranged_field(0.0, 0.0, 1.0)  # share of messages duplicated
    corrupt: float = build_ranged_field(0.0, 0.0, 1.0)  # share of messages with one byte changed
    cuts: tuple[tuple[float, float], ...] = ()  # [s] intervals [from, to] without transmission
    # period of `cuts`
    cut_period: float = build_ranged_field(math.inf, 0.0, math.inf, "s", above=True)
    reliable: Literal["delayed", "impaired", "clean"] = (
        "delayed"  # whether it applies to reliable topics
    )

    def __post_init__(self) -> None:
        check_ranges(self)
        if not 0.0 <= self.jitter <= self.delay:
            raise ValueError("jitter: must be 0 to delay [s]")
        if self.jitter_time != 0.0 and not 1e-4 <= self.jitter_time <= 100.0:
            raise ValueError("jitter_time: must be 0 or within 0.0001 ... 100 [s]")
        if self.burst_loss and not self.burst_enter <= 1.0:
            loss_max = self.burst_depth * self.burst_length / (self.burst_length + 1.0)
            raise ValueError(
                f"burst_loss: bursts of this length and depth lose {loss_max:.3g} at most"
            )
        times = [time for cut in self.cuts for time in cut]
        if times != sorted(times) or any(time < 0.0 for time in times):
            raise ValueError("cuts: pairs [from, to] in seconds, in order, not overlapping")

    @property
    def burst_leave(self) -> float:
        """Probability that a burst ends with a message."""
        return 1.0 / self.burst_length

    @property
    def burst_enter(self) -> float:
        """Probability that a burst begins with a message."""
        bad_share = self.burst_loss / self.burst_depth  # share of messages in the bad state
        return self.burst_leave * bad_share / (1.0 - bad_share) if bad_share < 1.0 else math.inf

    def cut_at(self, time_s: float) -> bool:
        """Return whether the direction is cut, by the clock, at `time_s` [s]."""
        phase_s = time_s % self.cut_period if time_s >= 0.0 else -1.0
        return any(start <= phase_s < end for start, end in self.cuts)

    def select_impairments(self, live: bool) -> "DirectionConfig":
        """Return the impairments of a live or a reliable topic."""
        if live or self.reliable == "impaired":
            return self
        if self.reliable == "clean":
            return DirectionConfig(cuts=self.cuts, cut_period=self.cut_period)
        return replace(self, loss=0.0, burst_loss=0.0, reorder=0.0, duplicate=0.0, corrupt=0.0)


@dataclass(frozen=True, slots=True)
class ImpairConfig(RangedConfig):
    """The proxy: its endpoint for the master, and the impairments of each direction.

    The slave and all listeners use the endpoints of `link`.
    """

    endpoint: str = "127.0.0.1:7449"  # HOST:PORT, the master's `link.slave`
    seed: int = 0  # of the random numbers; results are reproducible
    # duration of a cut after which presence is withdrawn
    presence: float = build_ranged_field(2.0, 0.0, math.inf, "s", may_be_infinite=True)
    to_slave: DirectionConfig = field(default_factory=DirectionConfig)  # from master to slave
    to_master: DirectionConfig = field(default_factory=DirectionConfig)  # from slave to master

    @staticmethod
    def require_direct(shared: LinkConfig) -> None:
        """Raise `UsageError` if master and slave meet at a router, with no place for a proxy."""
        if shared.routers:
            raise UsageError("impair: works between direct neighbours only, without link.routers")

    def build_link_config(self, shared: LinkConfig) -> LinkConfig:
        """Return the master's link: as `shared`, but to the proxy."""
        try:
            return replace(shared, slave=self.endpoint)
        except ValueError as error:
            raise UsageError(f"impair.endpoint: {error}") from error
