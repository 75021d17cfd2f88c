"""The measured endoscope: friction against bend, and bends predicted that were not fitted."""

import numpy as np
import pytest

from estimator.pair.pair_fit import PairVariant
from estimator.pair.pair_study import COMMAND, SHARE, run_study
from teleop.cli.pair import PairConfig, read_records
from teleop.data.mapping_file import TableMapping

pytestmark = [pytest.mark.measured, pytest.mark.slow]


@pytest.fixture(scope="module")
def found(measured_data):
    files = sorted((measured_data / "endoscope-pair").glob("bend*.csv"))
    if not files:
        pytest.skip(f"no endoscope-pair in {measured_data}")
    return run_study(
        tuple(record for record, _ in read_records(files, PairConfig(), TableMapping()))
    )


def shares(found, method):
    return np.array([error.share for error in found.left_out[method]])


def test_friction_grows_with_the_bend_in_a_straight_line(found):
    K = np.array([number.value for number in found.record_frictions])
    assert np.all(np.diff(K) > 0.1)
    line = [found.fit.model.compute_friction(record.bend) for record in found.records]
    np.testing.assert_allclose(K, line, atol=0.06)
    assert 0.14 < found.growth.low < found.growth.value < found.growth.high < 0.21


def test_bends_left_out_are_predicted(found):
    ours = shares(found, PairVariant.FULL.value)
    assert ours.mean() < 0.07
    assert np.all(ours[:4] < 0.07)  # the last is the farthest, its zero is odd and its span least
    for baseline in (COMMAND, SHARE, PairVariant.ONE_K.value):
        assert ours.mean() < 0.3 * shares(found, baseline).mean()
    for share in ("rmse", "share"):  # at most that of the best model without tendons
        mean, simple = (
            np.mean([getattr(error, share) for error in found.left_out[method]])
            for method in (PairVariant.FULL.value, found.best_simple)
        )
        assert mean < simple
    assert np.all(np.array([e.zeroed for e in found.left_out[PairVariant.FULL.value]]) < 0.08)


def test_the_two_tensions_alone_tell_the_angle_too(found):
    assert shares(found, PairVariant.TENSIONS.value).mean() < 0.1
