"""Constants and state of the fault detection of one tendon."""

from estimator.records import F64, Struct
from slave.fault_detection.average import TendonAverage
from slave.fault_detection.broken_tendon import SlackState
from slave.fault_detection.cell import LoadCell
from slave.fault_detection.compliance import ComplianceBounds


class CheckedTendon(Struct):
    """One tendon: constants of its model, then the state of its checks."""

    compliance: ComplianceBounds
    noise: F64 = 0.0  # [N] of its load cell
    cell: LoadCell
    average: TendonAverage
    slack: SlackState
