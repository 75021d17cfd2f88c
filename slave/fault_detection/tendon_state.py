"""Constants and state of the fault detection of one tendon."""

from estimator.records import F64, Record
from slave.fault_detection.average import AveragedTendon
from slave.fault_detection.broken_tendon import Slack
from slave.fault_detection.cell import LoadCell
from slave.fault_detection.compliance import Compliance


class CheckedTendon(Record):
    """One tendon: constants of its model, then the state of its checks."""

    compliance: Compliance
    noise: F64 = 0.0  # [N] of its load cell
    cell: LoadCell
    average: AveragedTendon
    slack: Slack
