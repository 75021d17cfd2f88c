"""What all tests may ask for."""

import os
from pathlib import Path

import pytest

from teleop import compile_cache

ROOT = Path(__file__).parents[1]
compile_cache.choose()  # before anything imports numba


@pytest.fixture
def demo_config() -> Path:
    return ROOT / "configs" / "demo.yaml"


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """The folder of measured data, which is not part of the project; skips without it."""
    folder = Path(os.environ.get("TELEOP_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no measured data at {folder} (set TELEOP_SHARED_DATA)")
    return folder
