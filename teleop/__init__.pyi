from slave.rigs.bench import BenchRun, MotionScale, make_spring_bench, simulate
from teleop.data.recording_table import DataTable, RecordedEvent, read_table
from teleop.errors import PeerError, TeleopError, UsageError
from teleop.launch.config import SessionConfig
from teleop.launch.session import Session, load_config
from teleop.remote.client import SessionClient, SessionEvent, TipState, join_session

__all__ = [
    "BenchRun",
    "DataTable",
    "MotionScale",
    "PeerError",
    "RecordedEvent",
    "Session",
    "SessionClient",
    "SessionConfig",
    "SessionEvent",
    "TeleopError",
    "TipState",
    "UsageError",
    "join_session",
    "load_config",
    "make_spring_bench",
    "read_table",
    "simulate",
]
