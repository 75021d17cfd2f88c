"""Config of CiA 402 drives on a CAN bus, with the load of the bus and the drives' period."""

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from teleop.config.ranges import RangedConfig, build_ranged_field, check_ranges

# --- share of a CAN bus that cyclic PDOs take

LOAD_MAX = 0.95
HEARTBEATS_HZ = 110.0  # ours, every 10 ms, and one a node every 100 ms


def compute_frame_bits(data: int) -> int:
    """Return the most bits of a frame with 11-bit identifier and `data` bytes, stuffing included.

    44 bits of frame and 3 of interframe space; one stuff bit for every four of the 34 + 8 data bits
    that are stuffed, less one (Tindell, Burns 1994; Davis et al. 2007).
    """
    stuffed = 34 + 8 * data
    return 47 + 8 * data + (stuffed - 1) // 4


def compute_bus_load(
    bitrate: float,
    rate_hz: float,
    drives: int,
    cells: int,
    together: int,
    wide: bool,
    beats_hz: float = HEARTBEATS_HZ,
) -> float:
    """Return the share of the bus in use in the worst case.

    Each cycle, at `rate_hz`, carries a SYNC, a PDO of control word and target to each drive, one of
    status word and position back, and the cells' values: of 16 bits beside a drive's own, otherwise
    (`wide`: 32 bits) in a PDO of their own. So many nodes have a motor, a cell, and both. Besides
    there are `beats_hz` frames a second of NMT error control: heartbeats, or node guarding.
    """
    width = 4 if wide else 2
    shared = 0 if wide else together
    cycle = compute_frame_bits(0) + drives * compute_frame_bits(6)
    cycle += (drives - shared) * compute_frame_bits(6) + shared * compute_frame_bits(6 + width)
    cycle += (cells - shared) * compute_frame_bits(width)
    return (cycle * rate_hz + beats_hz * compute_frame_bits(1)) / bitrate


# --- the interpolation period of a drive (object 60C2): a count of units of a power of ten

RATE_MIN, RATE_MAX = 10.0, 2000.0  # [Hz] of SYNC
COUNT_MAX = 255  # of 60C2:1, unsigned 8 bits
EXPONENTS = (-3, -4, -5)  # of 60C2:2, in order of preference: drives know milliseconds best
TOLERANCE = 1e-5  # of a rate that is written with six digits


def encode_period(rate_hz: float) -> tuple[int, int]:
    """Return the period of a rate [Hz] as a count, and the exponent of ten of its unit [s].

    `ValueError` if the period is no whole number of any unit; the nearest rate with such a period
    is named.
    """
    for exponent in EXPONENTS:
        period = 10.0**-exponent / rate_hz
        count = round(period)
        if 1 <= count <= COUNT_MAX and math.isclose(period, count, rel_tol=TOLERANCE):
            return count, exponent
    nearest_hz = min(_list_usable_rates(), key=lambda usable_hz: abs(usable_hz - rate_hz))
    raise ValueError(
        f"rate_hz: its period must be 1 to {COUNT_MAX} whole units of 1, 0.1 or 0.01 ms (object "
        f"60C2); the nearest is {nearest_hz:.6g} Hz"
    )


def _list_usable_rates() -> list[float]:
    rates = (10.0**-e / count for e in EXPONENTS for count in range(1, COUNT_MAX + 1))
    return [rate for rate in rates if RATE_MIN <= rate <= RATE_MAX]


INT32_MIN, INT32_MAX = -(1 << 31), (1 << 31) - 1
FOLLOWING_ERROR_MAX = (1 << 32) - 2  # [counts] one more switches the supervision off (6065)
FOLLOWING_TIME_MAX = 65.5  # [s] 16 bits of milliseconds (6066)
# heartbeats, or requests to a guarded drive, in the time of its watchdog
HEARTBEATS_PER_TIMEOUT = 4


@dataclass(frozen=True, slots=True)
class BusConfig(RangedConfig):
    """A CAN bus as python-can opens it."""

    interface: str = "socketcan"  # socketcan, slcan, or any other of python-can
    channel: str = "can0"  # network interface, or port of the adapter
    # [bit/s] of the bus
    bitrate: int = build_ranged_field(1_000_000, 10_000, 1_000_000)
    tty_baud: int = 2_000_000  # of an slcan adapter
    # in which an slcan adapter restarts after opening
    tty_wait: float = build_ranged_field(2.0, 0.0, 10.0, "s")

    def build_arguments(self) -> dict[str, Any]:
        """Return the arguments of `can.Bus`."""
        found: dict[str, Any] = {"interface": self.interface, "channel": self.channel}
        if self.channel.isdecimal():  # Kvaser and others count theirs
            found["channel"] = int(self.channel)
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
class AnalogueConfig(RangedConfig):
    """The object that a load cell is read from, in every node with a cell."""

    index: int = build_ranged_field(0x3160, 0x1000, 0xFFFF)  # of the object in the dictionary
    subindex: int = build_ranged_field(1, 0, 255)  # of the object
    bits: Literal[16, 32] = 16  # size of the object


@dataclass(frozen=True, slots=True, kw_only=True)
class Cia402Config:
    """CANopen drives; motors and cells are given by node number."""

    NUMBERS: ClassVar[range] = range(1, 128)  # of nodes
    type: Literal["cia402"] = "cia402"
    bus: BusConfig = field(default_factory=BusConfig)
    rate_hz: float = build_ranged_field(500.0, RATE_MIN, RATE_MAX, "Hz")  # of SYNC
    mode: Literal["position", "interpolation"] = "position"  # cyclic synchronous, or interpolated
    master: int = build_ranged_field(127, 1, 127)  # node number of this side's heartbeat
    # without our heartbeat, or without being guarded, a drive stops
    watchdog: float = build_ranged_field(0.040, 0.010, 0.050, "s")
    # what the drives watch: our heartbeat, or being guarded, for those that consume no heartbeat
    error_control: Literal["heartbeat", "guarding"] = "heartbeat"
    timeout: float = 0.050  # [s] without a PDO a node counts as silent
    # of the status word: position referenced; null: absolute encoder
    homed_bit: int | None = build_ranged_field(15, 0, 15)
    # beyond which the drive stops by itself
    following_error: int = build_ranged_field(2000, 1, FOLLOWING_ERROR_MAX, "counts")
    # for which it may be exceeded
    following_time: float = build_ranged_field(0.010, 0.0, FOLLOWING_TIME_MAX, "s")
    # lower limit, kept by the drive
    position_min: int = build_ranged_field(-1_000_000, INT32_MIN, INT32_MAX, "counts")
    # upper limit, kept by the drive
    position_max: int = build_ranged_field(1_000_000, INT32_MIN, INT32_MAX, "counts")
    velocity_max: int = build_ranged_field(5000, 1, INT32_MAX)  # in the drive's unit, often rpm
    quick_stop_deceleration: int = build_ranged_field(10_000, 1, INT32_MAX)  # in the drive's unit
    analogue: AnalogueConfig = field(default_factory=AnalogueConfig)

    def __post_init__(self) -> None:
        check_ranges(self)
        encode_period(self.rate_hz)
        if not 2.0 / self.rate_hz <= self.timeout <= 0.5:
            raise ValueError("timeout: must be two periods to 0.5 s")
        if not self.position_min < self.position_max:
            raise ValueError("position_min: must be below position_max")

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

        So many nodes have a motor, a cell, and both.
        """
        wide = self.analogue.bits == 32
        guarded = self.error_control == "guarding"
        beats_hz = 2.0 * drives / self.beat_s if guarded else HEARTBEATS_HZ  # request and answer
        idle, load = (
            compute_bus_load(self.bus.bitrate, rate_hz, drives, cells, together, wide, beats_hz)
            for rate_hz in (0.0, self.rate_hz)
        )
        if load > LOAD_MAX:
            limit_hz = self.rate_hz * (LOAD_MAX - idle) / (load - idle)
            lower_hz = max((hz for hz in _list_usable_rates() if hz <= limit_hz), default=RATE_MIN)
            raise ValueError(
                f"the bus would be {load:.0%} full at {self.rate_hz:g} Hz, {LOAD_MAX:.0%} at most: "
                f"lower rate_hz to {lower_hz:.6g} or less, or use two buses"
            )
        return load
