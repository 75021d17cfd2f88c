"""The master's section of a config file."""

from dataclasses import dataclass, field

from master.devices import DeviceConfig
from master.devices.virtual import VirtualConfig
from master.feedback import FeedbackConfig
from master.gate import GateConfig
from master.operator import OperatorConfig


@dataclass(frozen=True, slots=True)
class MasterConfig:
    """Everything the master process needs."""

    device: DeviceConfig = field(default_factory=VirtualConfig)
    operator: OperatorConfig = field(default_factory=OperatorConfig)
    force: FeedbackConfig = field(default_factory=FeedbackConfig)
    gate: GateConfig = field(default_factory=GateConfig)
    freshness: float = 0.030  # [s] a force measured longer ago than this is not rendered
    delay_max: float = 0.100  # [s] nor is one that answers a command older than this

    def __post_init__(self) -> None:
        """Refuse a state that never grows old."""
        if not 0.0 < self.freshness <= 0.5:
            raise ValueError("freshness: must be above 0 and at most 0.5 [s]")
        if not self.freshness <= self.delay_max <= 1.0:
            raise ValueError("delay_max: must be at least freshness and at most 1 [s]")
        room = min(self.force.limit, self.gate.axis_max)
        if any(abs(force) >= room for force in self.operator.weight):
            raise ValueError(f"operator.weight: must leave room below force.limit ({room:g} N)")
