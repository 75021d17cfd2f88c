"""The master's section of a config file."""

from dataclasses import dataclass, field

from master.devices import DeviceConfig
from master.devices.virtual import VirtualConfig
from master.feedback import FeedbackConfig
from master.gate import GateConfig
from master.mapping_config import MappingConfig
from master.operator import OperatorConfig
from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.errors import UsageError
from teleop.session.config import RATE_MAX_HZ, RATE_MIN_HZ, require_periods


@dataclass(frozen=True, slots=True)
class MasterConfig:
    """Settings of the master process."""

    # haptic device in the operator's hand
    device: DeviceConfig = field(default_factory=VirtualConfig)
    # from the device's axes to the joints; null = axis k moves joint k
    mapping: MappingConfig | None = None
    operator: OperatorConfig = field(default_factory=OperatorConfig)
    force: FeedbackConfig = field(default_factory=FeedbackConfig)
    gate: GateConfig = field(default_factory=GateConfig)
    # an older slave state is not rendered
    state_timeout: float = build_ranged_field(0.030, 0.0, 0.5, "s", above=True)
    delay_max: float = 0.100  # [s] largest round trip: age of the command that the state answers
    # at which the device is read and written: a whole multiple of rate_hz; null = rate_hz
    device_rate_hz: float | None = build_ranged_field(None, RATE_MIN_HZ, RATE_MAX_HZ, "Hz")

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.state_timeout <= self.delay_max <= 1.0:
            raise ValueError("delay_max: must be at least state_timeout and at most 1 [s]")
        room = min(self.force.limit, self.gate.axis_max)
        if any(abs(force) >= room for force in self.operator.weight):
            raise ValueError(
                f"operator.weight: must be small enough to stay below force.limit ({room:g} N)"
            )

    def check_rate(self, rate_hz: float) -> None:
        """Check the settings against the link's rate [Hz]; raises `UsageError`."""
        self.count_ticks_per_command(rate_hz)
        require_periods("master.state_timeout", self.state_timeout, rate_hz)
        require_periods("master.delay_max", self.delay_max, rate_hz)

    def count_ticks_per_command(self, rate_hz: float) -> int:
        """Return the number of device ticks per command on the link, which has `rate_hz` [Hz].

        `UsageError` if `device_rate_hz` is not a multiple of that.
        """
        if self.device_rate_hz is None:
            return 1
        ticks = round(self.device_rate_hz / rate_hz)
        if ticks < 1 or abs(self.device_rate_hz / rate_hz - ticks) > 1e-6 * ticks:
            raise UsageError(
                f"master.device_rate_hz: {self.device_rate_hz:g}: must be an integer multiple of "
                f"rate_hz ({rate_hz:g} Hz)"
            )
        return ticks
