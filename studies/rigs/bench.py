"""A bus model as a process, and the config of a rig on it."""

import json
import subprocess
import sys
from pathlib import Path

import yaml

from studies.rigs.models.plant import COUNTS, NEWTONS, RADIUS, ZERO

BUS = "TELEOP_CAN_BUS"  # of the environment: interface,channel of python-can in place of slcan
TIMEOUT_S = 0.09  # of the buses: the model beside the session is held up at times
TRUE_K = 0.15 * 1.5 / 0.225  # of the plant's sheaths
MODEL_TENDON = [{"effective_friction": TRUE_K, "tension_noise": 0.01}]


class Model:
    """`studies.rigs.model` as a process."""

    def __init__(self, driver: str, motors: int, plant: str, realtime: bool = True) -> None:
        words = [driver, str(motors), plant, *(["ordinary"] if not realtime else [])]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "studies.rigs.model", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.buses = json.loads(self._process.stdout.readline())  # motors, perhaps cells: a config

    def order(self, word: str = "state") -> dict:
        """Give an order; return the state of motors and plant."""
        self._process.stdin.write(word + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def __enter__(self) -> "Model":
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._process.communicate(timeout=5.0)  # closes its input: then it ends
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()


def build_rig_tree(buses: dict, motors: int, paired: bool) -> dict:
    """Return the section `slave.rig` of a config."""
    tendons = [
        {
            "motor": {"id": k, "pulley_radius": RADIUS, "counts_per_turn": COUNTS, "zero": ZERO},
            "cell": {"id": k, "scale": NEWTONS},
        }
        for k in range(1, motors + 1)
    ]
    size = 2 if paired else 1
    joints = [{"tendons": tendons[k : k + size]} for k in range(0, motors, size)]
    patient = {name: bus | {"timeout": TIMEOUT_S} for name, bus in buses.items()}
    return {"type": "hardware", "name": "bench", **patient, "joints": joints}


def write_config(path: Path, buses: dict, motors: int, **slave: object) -> Path:
    """Write the config of a session on the model's buses."""
    rig = build_rig_tree(buses, motors, paired=motors > 1)
    gate = {"displacement_min": -0.035, "displacement_max": 0.035}
    hand = {"type": "sine", "amplitude": 0.02, "frequency": 0.3}
    tree = {
        "session": path.stem,
        "rate_hz": 500,
        "slave": {"rig": rig, "gate": gate, "tendons": MODEL_TENDON, **slave},
        "master": {
            "device": {
                "type": "virtual",
                "reference": hand,
                "engage": [[0.5, 5.5]],
                "engage_period": 6.0,
            }
        },
    }
    path.write_text(yaml.safe_dump(tree))
    return path
