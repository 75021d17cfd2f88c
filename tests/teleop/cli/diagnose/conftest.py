"""Learned models of few trees: what they are worth is tested where they are."""

import pytest

from estimator.diagnosis import learned


@pytest.fixture(scope="package", autouse=True)
def few_trees():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learned, "_TREES", 8)
        yield
