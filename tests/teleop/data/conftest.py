"""Where a test of this folder writes a record."""

import pytest


@pytest.fixture
def path(tmp_path):
    return tmp_path / "data.csv"
