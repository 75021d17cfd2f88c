import sys

import pytest


@pytest.fixture(autouse=True)
def without_learning(monkeypatch):
    """Compare with no learned models, which take a fifth of each diagnosis."""
    monkeypatch.setitem(sys.modules, "sklearn", None)
