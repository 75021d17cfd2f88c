from slave.rigs.bench import BenchRun, MotionScale, make_spring_bench, simulate
from teleop.errors import PeerError, TeleopError, UsageError
from teleop.launch.config import SessionConfig
from teleop.launch.session import Session, load_config
from teleop.remote.client import SessionClient, SessionEvent, TipState, join_session

__all__ = [
    "BenchRun",
    "MotionScale",
    "PeerError",
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
    "simulate",
]
