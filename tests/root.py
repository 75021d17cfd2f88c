"""Where the repository is; importing this changes nothing, unlike `conftest`."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
