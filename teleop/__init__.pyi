from slave.rigs.virtual_bench import BenchRun, MotionScale, make_spring_bench, simulate
from teleop.config.arm import load_arm
from teleop.data.recording_table import RecordedEvent, RecordingTable, read_recording
from teleop.errors import PeerError, TeleopError, UsageError
from teleop.experiment.design import BayesianAdaptive, ConstantStimuli, Design, Staircase, Trial
from teleop.experiment.psychometric import draw_psychometric, fit_psychometric
from teleop.experiment.run import ButtonObserver, Experiment, KeyObserver, run_experiment
from teleop.experiment.trial_table import read_trials
from teleop.launch.config import SessionConfig
from teleop.launch.session import Session, load_config
from teleop.remote.client import SessionClient, SessionEvent, TipState, join_session
from teleop.runtime.status_line import Progress

__all__ = [
    "BayesianAdaptive",
    "BenchRun",
    "ButtonObserver",
    "ConstantStimuli",
    "Design",
    "Experiment",
    "KeyObserver",
    "MotionScale",
    "PeerError",
    "Progress",
    "RecordedEvent",
    "RecordingTable",
    "Session",
    "SessionClient",
    "SessionConfig",
    "SessionEvent",
    "Staircase",
    "TeleopError",
    "TipState",
    "Trial",
    "UsageError",
    "draw_psychometric",
    "fit_psychometric",
    "join_session",
    "load_arm",
    "load_config",
    "make_spring_bench",
    "read_recording",
    "read_trials",
    "run_experiment",
    "simulate",
]
