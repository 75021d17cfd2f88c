"""Values that are missing in one channel are not compared; rows without the driver are removed."""

import numpy as np
import pytest

from estimator.diagnosis.record import RecordError, prepare
from tests import hidden

LOST = slice(600, 650)  # 1 s
Q, T_IN, T_OUT = "proximal_displacement", "proximal_tension", "distal_tension"


@pytest.fixture(scope="module")
def whole():
    """A record without effects, of a tip that pulls a spring."""
    return hidden.make(5, (), bench="spring", duration=30.0, rate=50.0)


def without(data, channel, rows):
    """Return the channels of a record, some values of one of them missing."""
    signal = data.channels[channel].copy()
    signal[rows] = np.nan
    return data.channels | {channel: signal}


def is_lost(record, data):
    """Return which samples of a record are those that are missing."""
    times = data.time[LOST] - data.time[0]
    return (record.time >= times[0] - 1e-6) & (record.time <= times[-1] + 1e-6)


@pytest.mark.parametrize("channel", [T_OUT, T_IN, "distal_displacement"])
def test_missing_values_are_not_compared_and_change_nothing_else(whole, channel):
    complete = prepare(whole.time, dict(whole.channels))
    record = prepare(whole.time, without(whole, channel, LOST))
    lost = is_lost(record, whole)
    assert not record.good[channel][lost].any()
    np.testing.assert_array_equal(record.good[channel][~lost], complete.good[channel][~lost])
    np.testing.assert_array_equal(record.drive, complete.drive)
    assert record.noise[channel] == pytest.approx(complete.noise[channel], rel=0.05)
    assert (record.measured & ~record.shown(channel)).sum() == 50
    for other in set(record.compared) - {channel}:
        np.testing.assert_array_equal(record.good[other], complete.good[other])
        np.testing.assert_array_equal(record.shown(other), record.measured)
    (said,) = [one for one in record.troubles if "missing" in one.what]
    assert (said.channel, said.samples) == (channel, 50)
    assert said.first == pytest.approx(whole.time[LOST][0])


def test_rows_without_what_drives_are_removed(whole):
    record = prepare(whole.time, without(whole, Q, LOST))
    assert record.measured.sum() == len(whole.time) - 50
    assert not is_lost(record, whole)[record.measured].any()
    (said,) = [one for one in record.troubles if "rows removed" in one.what]
    assert (said.channel, said.samples) == (Q, 50)


def test_a_start_without_tension_is_not_taken_for_slack(whole):
    assert prepare(whole.time, dict(whole.channels)).starts_slack
    record = prepare(whole.time, without(whole, T_IN, slice(0, 200)))
    assert not record.starts_slack


def test_cells_that_a_slow_sensor_leaves_empty_do_not_count(whole):
    empty = np.arange(len(whole.time)) % 5 > 0
    record = prepare(whole.time, without(whole, T_OUT, empty), most=800)
    assert record.thinned == 2
    assert record.good[T_OUT].sum() == pytest.approx(len(whole.time) / 5, rel=0.05)


def test_channels_that_are_never_measured_together_are_refused(whole):
    turns = np.arange(len(whole.time)) % 2 == 0
    apart = without(whole, Q, turns) | {T_IN: without(whole, T_IN, ~turns)[T_IN]}
    with pytest.raises(RecordError, match="proximal_tension: 0 values in rows that have the"):
        prepare(whole.time, apart)
    nothing = whole.channels | {T_OUT: np.full(len(whole.time), np.nan)}
    with pytest.raises(RecordError, match="distal_tension: has no finite value"):
        prepare(whole.time, nothing)
