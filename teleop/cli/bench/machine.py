"""Description of the machine of a measurement."""

import os
import platform
import subprocess
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from teleop.runtime.parallel import count_processors

PACKAGES = ("tendon-teleop", "eclipse-zenoh", "numpy", "numba", "scipy")


def describe_machine() -> dict[str, Any]:
    """Return processor, cores, kernel, versions, commit and the load before the measurement."""
    return {
        "cpu": _read_cpu_model(),
        "cores": count_processors(),
        "kernel": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "packages": {name: _find_version(name) for name in PACKAGES},
        "commit": _find_commit(),
        "load_average": [round(load, 2) for load in os.getloadavg()],
    }


def format_description(machine: dict[str, Any], realtime: Sequence[str]) -> list[str]:
    """Return the description as text; `realtime` is the scheduling granted to the loops."""
    packages = ", ".join(f"{name} {number}" for name, number in machine["packages"].items())
    return [
        f"machine   {machine['cpu']}, {machine['cores']} cores, {machine['kernel']}, "
        f"load {machine['load_average'][0]:.1f} at the start",
        f"software  Python {machine['python']}, {packages}, "
        f"commit {machine['commit'] or 'unknown'}",
        f"granted   {', '.join(realtime) or 'nothing'}",
    ]


def _read_cpu_model() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in text.splitlines() if "model name" in line]
    return names[0] if names else platform.machine()


def _find_version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _find_commit() -> str | None:
    """Return the commit of the sources; None outside a repository, `+` if they were changed."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    try:
        words = ["git", "-C", str(root), "describe", "--always", "--dirty=+", "--exclude=*"]
        done = subprocess.run(words, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()
