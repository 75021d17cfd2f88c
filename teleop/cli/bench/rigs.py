"""Config of a session to measure: a simulated arm of a number of joints, a hand for each."""

import json
from pathlib import Path
from typing import Any


def write_config(path: Path, joints: int) -> Path:
    """Write the config of an arm of `joints` joints, two tendons each; return `path`.

    The sheaths are those of configs/arm.yaml, one bend longer for each joint further out; the last
    joint closes on tissue.
    """
    path.write_text(json.dumps(_build_config(joints)))  # which is YAML, too
    return path


def _build_config(joints: int) -> dict[str, Any]:
    environments: list[dict[str, Any]] = [{"type": "free"} for _ in range(joints - 1)]
    environments.append({"type": "tissue", "position": 0.003, "stiffness": 10000, "exponent": 1.5})
    body = {
        "mass": 0.02, "damping": 2.0, "friction": 0.1, "spring": 0.0,
        "pretension": 0.5, "stops": [-0.008, 0.008],
    }  # fmt: skip
    rig = {
        "type": "simulated",
        "name": f"bench-{joints}",
        "joints": [
            {
                "tendons": [_build_tendon(k), _build_tendon(k)],
                "body": body,
                "environment": environment,
            }
            for k, environment in enumerate(environments)
        ],
    }
    gate = {
        "displacement_min": -0.025, "displacement_max": 0.025, "speed_max": 0.05, "tension_max": 25,
    }  # fmt: skip
    reference = {
        "type": "reaches", "targets": [0.0, 0.02, -0.01, 0.025, -0.02], "reach": 0.8, "rest": 0.3,
    }  # fmt: skip
    device = {
        "type": "virtual", "axes": joints, "reference": reference, "engage": [[0.2, 1e6]],
    }  # fmt: skip
    return {
        "slave": {"rig": rig, "calibration": "as-built", "gate": gate},
        "master": {
            "device": device,
            "operator": {"position_scale": 0.25},
            "force": {"scale": 0.2},
        },
    }


def _build_tendon(joint: int) -> dict[str, Any]:
    sections: list[dict[str, float]] = [
        {"length": 0.4},
        {"length": 0.5, "radius": 0.15},
        {"length": 0.4, "radius": 0.40},
    ]
    if joint:
        sections.append({"length": 0.06 * joint, "radius": 0.05})
    return {"sheath": {"sections": sections, "friction": 0.1, "axial_stiffness": 9000}}
