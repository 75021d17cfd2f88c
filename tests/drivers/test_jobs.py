"""The whole job of each driver on its model, from the calibration to every way it can fail."""

import pytest

from studies.rigs import jobs
from studies.rigs.models.board import COMPILER

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(COMPILER is None, reason="no C++ compiler, so the firmware is not compiled"),
]


@pytest.mark.parametrize("name", jobs.JOBS)
@pytest.mark.parametrize("motors", [1, 4])
@pytest.mark.parametrize("driver", jobs.DRIVERS)
def test_the_job(driver, motors, name, monkeypatch):
    monkeypatch.setattr(jobs, "RATE_MIN", 0.5)  # on a busy machine; the study asks for all of it
    jobs.perform_job(jobs.JOBS[name], driver, motors)
