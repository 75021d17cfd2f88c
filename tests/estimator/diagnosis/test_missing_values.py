"""Values that are missing in one channel are not compared; rows without the driver are removed."""

import numpy as np
import pytest

import estimator as est
from estimator.diagnosis.measured_data import RecordError, prepare_record
from estimator.diagnosis.scoring import compute_autocorrelation, resample_residual
from estimator.effects.effect import EffectContext
from estimator.effects.ends import find_largest_deviation
from estimator.effects.sensors import PULLEY_ECCENTRICITY
from estimator.measured_data import Samples
from tests.studies import hidden

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


def test_a_start_without_tension_is_not_taken_for_slack(whole):
    assert prepare_record(whole.time, dict(whole.channels)).starts_slack
    record = prepare_record(whole.time, without(whole, T_IN, slice(0, 200)))
    assert not record.starts_slack


def test_cells_that_a_slow_sensor_leaves_empty_do_not_count(whole):
    empty = np.arange(len(whole.time)) % 5 > 0
    record = prepare_record(whole.time, without(whole, T_OUT, empty), samples_max=800)
    assert record.decimation_factor == 2
    assert record.valid[T_OUT].sum() == pytest.approx(len(whole.time) / 5, rel=0.05)


def test_channels_that_are_never_measured_together_are_refused(whole):
    turns = np.arange(len(whole.time)) % 2 == 0
    apart = without(whole, Q, turns) | {T_IN: without(whole, T_IN, ~turns)[T_IN]}
    with pytest.raises(RecordError, match="proximal_tension: 0 values in rows that have the"):
        prepare_record(whole.time, apart)
    nothing = whole.channels | {T_OUT: np.full(len(whole.time), np.nan)}
    with pytest.raises(RecordError, match="distal_tension: has no finite value"):
        prepare_record(whole.time, nothing)


def test_infinite_values_are_missing(whole):
    lost = without(whole, T_OUT, LOST)
    infinite = lost | {T_OUT: np.where(np.isnan(lost[T_OUT]), np.inf, lost[T_OUT])}
    one, other = prepare_record(whole.time, lost), prepare_record(whole.time, infinite)
    np.testing.assert_array_equal(one.signals[T_OUT], other.signals[T_OUT])
    assert one.issues == other.issues


@pytest.mark.parametrize("channel", [T_IN, T_OUT])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_channel_without_values_is_named(whole, channel, value):
    data = Samples(whole.time, **whole.channels | {channel: np.full(len(whole.time), value)})
    remedy = "check the load cell" if channel == T_IN else "remove the channel"
    with pytest.raises(RecordError, match=rf"^{channel}: has no finite value: .*{remedy}$"):
        est.diagnose(data)


def test_an_infinite_time_is_refused(whole):
    time = whole.time.copy()
    time[-1] = np.inf
    with pytest.raises(RecordError, match="time: sample 1499 is inf"):
        prepare_record(time, dict(whole.channels))


def test_times_are_those_of_the_file_where_the_first_rows_are_removed(whole):
    record = prepare_record(whole.time + 100.0, without(whole, Q, slice(0, 100)))
    assert record.time[0] == 0.0
    assert record.start == pytest.approx(whole.time[100] + 100.0)
    times = record.start + record.time[record.measured]
    np.testing.assert_allclose(times, whole.time[100:] + 100.0, atol=1e-9)
    (said,) = [one for one in record.issues if "rows removed" in one.what]
    assert said.first == pytest.approx(whole.time[0] + 100.0)


def test_a_slow_sensor_of_a_thinned_record_keeps_its_times_and_its_noise(whole):
    held = whole.channels[T_OUT][np.arange(len(whole.time)) // 4 * 4]
    signals = whole.channels | {T_OUT: held}
    record = prepare_record(whole.time, signals, samples_max=800, noise={T_OUT: 0.1, T_IN: 0.1})
    assert record.decimation_factor == 2
    true = np.interp(record.time, whole.time - whole.time[0], whole.channels[T_OUT])
    rows = record.valid[T_OUT]
    slope = np.gradient(true, record.time)[rows]
    late = float(slope @ (record.signals[T_OUT] - true)[rows] / (slope @ slope))
    assert abs(late) < 0.1 / 50.0
    assert record.noise[T_OUT] == pytest.approx(0.1)  # of one value
    assert record.noise[T_IN] == pytest.approx(0.1 / np.sqrt(2.0))  # of two


def test_no_mean_of_samples_on_both_sides_of_a_gap_counts(whole):
    rows = (whole.time < 10.0) | (whole.time > 15.01)
    rows[0] = False  # an odd number is before the gap, and k is 2
    signals = {name: signal[rows] for name, signal in whole.channels.items()}
    record = prepare_record(whole.time[rows], signals, samples_max=700)
    within = (record.time + record.start > 10.0) & (record.time + record.start < 15.0)
    assert record.decimation_factor == 2
    assert within.any()
    assert not record.valid[T_OUT][within].any()


def test_values_missing_at_the_ends_are_not_drawn(whole):
    lost = np.r_[0:40, len(whole.time) - 60 : len(whole.time)]
    record = prepare_record(whole.time, without(whole, T_OUT, lost))
    assert (record.measured & ~record.select_drawn_rows(T_OUT)).sum() == 100


def test_a_record_begins_with_the_first_tension_that_was_measured(whole):
    record = prepare_record(whole.time, without(whole, T_IN, slice(0, 200)))
    drive, tensions = record.first_tensions
    row = int(np.argmax(record.present[T_IN]))
    assert drive == record.drive[row]
    np.testing.assert_allclose(tensions, record.signals[T_IN][row : row + 5])


def context_with(missing):
    """Return a context whose tension differs at 20 s, and in a wave, and is `missing` at 5 s."""
    time = np.arange(0.0, 40.0, 0.02)
    travel = 0.02 * (1.0 - np.cos(0.5 * time))
    simulated = 5.0 + 100.0 * travel
    present = ~((time > 5.0) & (time < 8.0))
    measured = simulated + 0.1 * np.sin(travel / 5e-3) + ((time > 20.0) & (time < 21.0))
    return EffectContext(
        time,
        Q,
        travel,
        np.gradient(travel, time),
        {T_IN: np.where(present, measured, missing)},
        {T_IN: simulated},
        np.full(len(time), 1e-2),
        1e-2,
        present={T_IN: present},
    )


def test_what_was_not_measured_tells_no_effect():
    one, other = context_with(0.0), context_with(9.0)
    assert find_largest_deviation(other, 1.0) == pytest.approx(20.0, abs=0.1)
    assert PULLEY_ECCENTRICITY.starts(one) == PULLEY_ECCENTRICITY.starts(other)


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


def test_the_lag_of_an_autocorrelation_is_a_time():
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 60.0, 0.02)
    time = time[rng.random(len(time)) > 0.3 * (time < 30.0)]
    residual = np.sin(2.0 * np.pi * time)
    found = compute_autocorrelation([resample_residual(time, residual, 0.02)], 0.02)
    assert found.lag[50] == pytest.approx(1.0)
    assert found.value[50] == pytest.approx(1.0, abs=0.02)
    assert found.value[25] == pytest.approx(-1.0, abs=0.02)
    even = np.append(residual[:100], np.nan)
    np.testing.assert_array_equal(resample_residual(0.01 * np.arange(101), even, 0.01), even)
