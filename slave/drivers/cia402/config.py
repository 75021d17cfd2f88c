"""Config of CiA 402 drives on a CAN bus."""

from dataclasses import dataclass, field
from typing import Any, Literal

from slave.drivers.cia402.bus_load import HEARTBEATS_HZ, LOAD_MAX, compute_bus_load
from slave.drivers.cia402.period import RATE_MAX, RATE_MIN, encode_period, highest_rate

INT32_MIN, INT32_MAX = -(1 << 31), (1 << 31) - 1
FOLLOWING_ERROR_MAX = (1 << 32) - 2  # [counts] one more switches the supervision off (6065)
FOLLOWING_TIME_MAX = 65.5  # [s] 16 bits of milliseconds (6066)
# heartbeats, or requests to a guarded drive, in the time of its watchdog
HEARTBEATS_PER_TIMEOUT = 4


@dataclass(frozen=True, slots=True)
class BusConfig:
    """A CAN bus as python-can opens it."""

    interface: str = "socketcan"  # socketcan, slcan, or any other of python-can
    channel: str = "can0"
    bitrate: int = 1_000_000
    tty_baud: int = 2_000_000  # of an slcan adapter
    tty_wait: float = 2.0  # [s] in which an slcan adapter restarts after opening

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not 10_000 <= self.bitrate <= 1_000_000:
            raise ValueError("bitrate: must be 10000 to 1000000")
        if not 0.0 <= self.tty_wait <= 10.0:
            raise ValueError("tty_wait: must be 0 to 10 s")

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `can.Bus`."""
        found: dict[str, Any] = {"interface": self.interface, "channel": self.channel}
        if self.interface == "slcan":
            found |= {
                "bitrate": self.bitrate,
                "tty_baudrate": self.tty_baud,
                "sleep_after_open": self.tty_wait,
            }
        elif self.interface not in ("socketcan", "virtual", "udp_multicast"):
            found["bitrate"] = self.bitrate
        return found


@dataclass(frozen=True, slots=True)
class AnalogueConfig:
    """The object that a load cell is read from, in every node with a cell."""

    index: int = 0x3160
    subindex: int = 1
    bits: Literal[16, 32] = 16

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not 0x1000 <= self.index <= 0xFFFF or not 0 <= self.subindex <= 255:
            raise ValueError("index: must be 0x1000 to 0xFFFF, subindex 0 to 255")


@dataclass(frozen=True, slots=True, kw_only=True)
class Cia402Config:
    """CANopen drives; motors and cells are given by node number."""

    type: Literal["cia402"] = "cia402"
    bus: BusConfig = field(default_factory=BusConfig)
    rate_hz: float = 500.0  # of SYNC
    mode: Literal["position", "interpolation"] = "position"  # cyclic synchronous, or interpolated
    master: int = 127  # node number of this side's heartbeat
    watchdog: float = 0.040  # [s] without our heartbeat, or without being guarded, a drive stops
    # what the drives watch: our heartbeat, or being guarded, for those that consume no heartbeat
    error_control: Literal["heartbeat", "guarding"] = "heartbeat"
    timeout: float = 0.050  # [s] without a PDO a node counts as silent
    homed_bit: int | None = 15  # of the status word: position referenced; None: absolute encoder
    following_error: int = 2000  # [counts] beyond which the drive stops by itself
    following_time: float = 0.010  # [s] for which it may be exceeded
    position_min: int = -1_000_000  # [counts] limits kept by the drive
    position_max: int = 1_000_000
    velocity_max: int = 5000  # in the drive's unit, often rpm
    quick_stop_deceleration: int = 10_000  # in the drive's unit
    analogue: AnalogueConfig = field(default_factory=AnalogueConfig)

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not RATE_MIN <= self.rate_hz <= RATE_MAX:
            raise ValueError(f"rate_hz: must be {RATE_MIN:g} to {RATE_MAX:g} Hz")
        encode_period(self.rate_hz)
        if not 1 <= self.master <= 127:
            raise ValueError("master: must be 1 to 127")
        if not 0.010 <= self.watchdog <= 0.050:
            raise ValueError("watchdog: must be 0.01 to 0.05 s")
        if not 2.0 / self.rate_hz <= self.timeout <= 0.5:
            raise ValueError("timeout: must be two periods to 0.5 s")
        if self.homed_bit is not None and not 0 <= self.homed_bit <= 15:
            raise ValueError("homed_bit: must be 0 to 15")
        for name in ("position_min", "position_max"):
            if not INT32_MIN <= getattr(self, name) <= INT32_MAX:
                raise ValueError(f"{name}: must be {INT32_MIN} to {INT32_MAX} counts")
        if not self.position_min < self.position_max:
            raise ValueError("position_min: must be below position_max")
        if not 1 <= self.following_error <= FOLLOWING_ERROR_MAX:
            raise ValueError(f"following_error: must be 1 to {FOLLOWING_ERROR_MAX} counts")
        if not 0.0 <= self.following_time <= FOLLOWING_TIME_MAX:
            raise ValueError(f"following_time: must be 0 to {FOLLOWING_TIME_MAX:g} s")
        for name in ("velocity_max", "quick_stop_deceleration"):
            if not 1 <= getattr(self, name) <= INT32_MAX:
                raise ValueError(f"{name}: must be 1 to {INT32_MAX}")

    @property
    def period(self) -> tuple[int, int]:
        """Interpolation period: count, and exponent of ten of its unit [s]."""
        return encode_period(self.rate_hz)

    @property
    def beat_s(self) -> float:
        """Time [s] between two heartbeats, or two requests to a guarded drive."""
        return self.watchdog / HEARTBEATS_PER_TIMEOUT

    def require_load(self, drives: int, cells: int, together: int) -> float:
        """Return the share of the bus in use; raises `ValueError` if it cannot fit.

        Parameters
        ----------
        drives, cells, together : int
            Nodes with a motor, with a cell, and with both.
        """
        wide = self.analogue.bits == 32
        guarded = self.error_control == "guarding"
        beats_hz = 2.0 * drives / self.beat_s if guarded else HEARTBEATS_HZ  # request and answer
        idle, load = (
            compute_bus_load(self.bus.bitrate, rate_hz, drives, cells, together, wide, beats_hz)
            for rate_hz in (0.0, self.rate_hz)
        )
        if load > LOAD_MAX:
            lower_hz = highest_rate(self.rate_hz * (LOAD_MAX - idle) / (load - idle))
            raise ValueError(
                f"the bus would be {load:.0%} full at {self.rate_hz:g} Hz, {LOAD_MAX:.0%} at most: "
                f"lower rate_hz to {lower_hz:.6g} or less, or use two buses"
            )
        return load
