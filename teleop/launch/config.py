"""The config of a whole session: shared keys and all sections."""

from dataclasses import dataclass, field

from master.config import MasterConfig
from slave.config import SlaveConfig
from teleop.impair.config import ImpairConfig
from teleop.link.router import RouterConfig
from teleop.recording.writer import RecordConfig
from teleop.ros.config import RosConfig
from teleop.session.config import SideConfig
from teleop.view.config import ViewConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionConfig(SideConfig):
    """All keys of a config file; `teleop run` checks them before it starts a process."""

    master: MasterConfig = field(default_factory=MasterConfig)
    slave: SlaveConfig = field(default_factory=SlaveConfig)
    record: RecordConfig = field(default_factory=RecordConfig)
    view: ViewConfig = field(default_factory=ViewConfig)
    impair: ImpairConfig | None = None  # with a proxy between master and slave
    ros: RosConfig = field(default_factory=RosConfig)
    router: RouterConfig = field(default_factory=RouterConfig)

    def __post_init__(self) -> None:
        """Check the values, and the timeouts against the rate; `ValueError` or `UsageError`."""
        SideConfig.__post_init__(self)
        self.master.check_rate(self.rate_hz)
        self.slave.check_rate(self.rate_hz)
        self.slave.check_arms(self.arms)
