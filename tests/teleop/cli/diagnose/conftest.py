"""Learned models of few trees, figures as they are laid out at first: neither is the point here."""

import pytest
from matplotlib.layout_engine import ConstrainedLayoutEngine

from estimator.diagnosis import learned


@pytest.fixture(scope="package", autouse=True)
def cheap_parts():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learned, "_TREES", 8)
        patch.setattr(ConstrainedLayoutEngine, "execute", lambda *_: None)
        yield
