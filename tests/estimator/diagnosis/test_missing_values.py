"""Values that are missing in one channel are not compared; rows without the driver are removed."""

import numpy as np
import pytest

import estimator as est
from estimator.diagnosis.record import RecordError, prepare_record
from estimator.measured_data import Samples
from studies import hidden_effects

LOST = slice(600, 650)  # 1 s
Q, T_IN, T_OUT = "proximal_displacement", "proximal_tension", "distal_tension"


@pytest.fixture(scope="module")
def whole():
    """A record without effects, of a tip that pulls a spring."""
    return hidden_effects.make(5, (), bench="spring", duration=30.0, rate=50.0)


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
    complete = prepare_record(whole.time, dict(whole.channels))
    record = prepare_record(whole.time, without(whole, channel, LOST))
    lost = is_lost(record, whole)
    assert not record.valid[channel][lost].any()
    np.testing.assert_array_equal(record.valid[channel][~lost], complete.valid[channel][~lost])
    np.testing.assert_array_equal(record.drive, complete.drive)
    assert record.noise[channel] == pytest.approx(complete.noise[channel], rel=0.05)
    assert (record.measured & ~record.select_drawn_rows(channel)).sum() == 50
    for other in set(record.compared) - {channel}:
        np.testing.assert_array_equal(record.valid[other], complete.valid[other])
        np.testing.assert_array_equal(record.select_drawn_rows(other), record.measured)
    (said,) = [one for one in record.issues if "missing" in one.what]
    assert (said.channel, said.samples) == (channel, 50)
    assert said.first == pytest.approx(whole.time[LOST][0])


def test_rows_without_what_drives_are_removed(whole):
    record = prepare_record(whole.time, without(whole, Q, LOST))
    assert record.measured.sum() == len(whole.time) - 50
    assert not is_lost(record, whole)[record.measured].any()
    (said,) = [one for one in record.issues if "rows removed" in one.what]
    assert (said.channel, said.samples) == (Q, 50)


def test_channels_that_are_never_measured_together_are_refused(whole):
    turns = np.arange(len(whole.time)) % 2 == 0
    apart = without(whole, Q, turns) | {T_IN: without(whole, T_IN, ~turns)[T_IN]}
    with pytest.raises(RecordError, match="proximal_tension: 0 values in rows that have the"):
        prepare_record(whole.time, apart)
    nothing = whole.channels | {T_OUT: np.full(len(whole.time), np.nan)}
    with pytest.raises(RecordError, match="distal_tension: has no finite value"):
        prepare_record(whole.time, nothing)


@pytest.mark.parametrize("channel", [T_IN, T_OUT])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_channel_without_values_is_named(whole, channel, value):
    data = Samples(whole.time, **whole.channels | {channel: np.full(len(whole.time), value)})
    remedy = "check the load cell" if channel == T_IN else "remove the channel"
    with pytest.raises(RecordError, match=rf"^{channel}: has no finite value: .*{remedy}$"):
        est.diagnose(data)


def test_times_are_those_of_the_file_where_the_first_rows_are_removed(whole):
    record = prepare_record(whole.time + 100.0, without(whole, Q, slice(0, 100)))
    assert record.time[0] == 0.0
    assert record.start == pytest.approx(whole.time[100] + 100.0)
    times = record.start + record.time[record.measured]
    np.testing.assert_allclose(times, whole.time[100:] + 100.0, atol=1e-9)
    (said,) = [one for one in record.issues if "rows removed" in one.what]
    assert said.first == pytest.approx(whole.time[0] + 100.0)


@pytest.mark.parametrize(("turns", "said"), [(True, 1), (False, 0)])
def test_a_gap_in_which_the_motor_turned_is_told(turns, said):
    time = np.arange(0.0, 40.0, 0.02)
    travel = 1e-3 * (1.0 - np.cos(0.5 * time))
    middle = 4.0 * np.pi if turns else 3.0 * np.pi  # [s]
    rows = np.abs(time - middle) > 0.7
    noise = np.random.default_rng(1).normal(0.0, 0.01, (2, len(time)))
    signals = {Q: travel, T_IN: 1.0 + 4e3 * travel + noise[0], T_OUT: 1.0 + 3e3 * travel + noise[1]}
    record = prepare_record(time[rows] + 100.0, {name: y[rows] for name, y in signals.items()})
    found = [one for one in record.issues if "may have turned" in one.what]
    assert len(found) == said
    for one in found:
        assert f"({99.3 + middle:.4g} to {100.7 + middle:.4g} s)" in one.what
        assert not one.excluded


def test_an_infinite_time_is_refused(whole):
    time = whole.time.copy()
    time[-1] = np.inf
    with pytest.raises(RecordError, match="time: sample 1499 is inf"):
        prepare_record(time, dict(whole.channels))
