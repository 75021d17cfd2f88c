"""The settings of a master's tick as one record, kept up to date with a config that may change."""

from typing import Annotated

from estimator.array_types import Array
from estimator.structs import (
    F64,
    Field,
    Struct,
    StructArray,
    build_struct_dtype,
    to_struct_array,
    view_struct,
)
from master.config import MasterConfig
from master.devices.combined import CombinedConfig
from master.feedback import FeedbackConfig
from master.gate import GateConfig
from master.operator import OperatorSettings, build_operator_settings
from teleop.coupling import Bilateral, BilateralSettings, to_bilateral_settings
from teleop.messages.messages import MAX_JOINTS


class MasterSettings(Struct):
    """All constants of a tick of the master."""

    operator: OperatorSettings
    force: Annotated[FeedbackConfig, Field(build_struct_dtype(FeedbackConfig))]
    gate: Annotated[GateConfig, Field(build_struct_dtype(GateConfig))]
    state_timeout: F64  # [s]
    delay_max: F64  # [s]
    bilateral: BilateralSettings
    # of each axis: force of the tips on its device over that on the hand
    force_share: Annotated[Array, Field("f8", MAX_JOINTS, fill=1.0)]


class SettingsRecord:
    """The record of a config that may change: `update` costs nothing while it is the same.

    `records` is an array of one `MasterSettings`, changed in place.
    """

    def __init__(self, config: MasterConfig, bilateral: Bilateral) -> None:
        self._config = config
        self.records = MasterSettings.array()
        settings = view_struct(self.records)
        settings.state_timeout, settings.delay_max = config.state_timeout, config.delay_max
        settings.bilateral = to_bilateral_settings(bilateral)[0]
        settings.gate = to_struct_array(config.gate)[0]
        settings.operator = build_operator_settings(config.operator)[0]
        settings.force = to_struct_array(config.force)[0]
        if isinstance(config.device, CombinedConfig):
            settings.force_share[: config.device.axis_count] = config.device.list_force_scales()

    def update(self, config: MasterConfig) -> StructArray:
        """Return the record of `config`, which may differ in `operator` and `force` (`live.KEYS`).

        Only a part that is another object than before is written anew.
        """
        previous, self._config = self._config, config
        if config.operator is not previous.operator:
            self.records["operator"] = build_operator_settings(config.operator)
        if config.force is not previous.force:
            self.records["force"] = to_struct_array(config.force)
        return self.records


def build_master_settings(config: MasterConfig, bilateral: Bilateral) -> StructArray:
    """Return the record of a config, as an array of one."""
    return SettingsRecord(config, bilateral).records
