"""Measured data as the rig: the live session estimates what `teleop estimate` does, to the bit."""

import json

import numpy as np
import pytest

from teleop.cli import commands
from teleop.data.measured_table import read_table
from teleop.messages.topics import HAND, TENDONS
from teleop.recording.reader import open_recording, read_columns
from tests.system.test_run import run

ROWS = 900  # of the measured session: 11 s


def live_and_offline(data, folder, demo_config):
    """Fit and estimate offline, then play the same data live; return both and the summaries."""
    calibration, estimates = folder / "sheath.yaml", folder / "estimates.csv"
    words = ["estimate", str(data), "--fit", "--save", str(calibration)]
    words += ["--out", str(estimates), "--json", str(folder / "estimate.json")]
    assert commands.main(words) == 0
    code, out, err = run(
        demo_config,
        folder,
        *("--replay", str(data), "--calibration", str(calibration)),
        *("--record", str(folder), "--view", "none"),
    )
    assert code == 0, out + err
    (recording,) = folder.glob("*.mcap")
    summaries = [json.loads((folder / f"{n}.json").read_text()) for n in ("estimate", "run")]
    return read_table(estimates), recording, *summaries


def assert_same(offline, recording):
    """Each row that was recorded is the offline one, and each that was not is counted as lost."""
    live = read_columns(recording, TENDONS.name)
    rows = np.searchsorted(offline.time, live["time_s"])
    np.testing.assert_array_equal(live["time_s"], offline.time[rows])
    missing = len(offline.time) - len(rows)
    assert missing == open_recording(recording).lost[TENDONS.name]
    assert missing < 0.01 * len(rows)
    for field, column in (
        ("distal_tension", "distal_tension_estimate_N"),
        ("distal_tension_low", "distal_tension_low_N"),
        ("distal_tension_high", "distal_tension_high_N"),
        ("elongation", "elongation_estimate_m"),
        ("front", "front_m"),
        ("phase", "phase"),
        ("status", "status"),
    ):
        np.testing.assert_array_equal(live[field][:, 0], offline.extra[column][rows], err_msg=field)


@pytest.mark.parametrize(
    "rate", ["82", *(pytest.param(rate, marks=pytest.mark.slow) for rate in ("1000", "2500"))]
)
def test_live_equals_offline_whatever_the_rate_of_the_data(rate, demo_config, tmp_path):
    data = tmp_path / "bench.csv"
    words = ["simulate", str(demo_config), "--out", str(data), "--profile", "nested"]
    words += ["--duration", "4", "--rate", rate, "--set", "slave.rig.period=0.0004"]
    assert commands.main(words) == 0
    offline, recording, estimate, live = live_and_offline(data, tmp_path, demo_config)
    assert_same(offline, recording)
    assert live["slave"]["force_error"] == pytest.approx(estimate["force_error"])


@pytest.mark.slow
@pytest.mark.measured
def test_measured_tensions_reach_the_hand(measured_data, demo_config, tmp_path):
    whole = (measured_data / "sheath-bench" / "session1.csv").read_text().splitlines()
    data = tmp_path / "measured.csv"
    data.write_text("\n".join(whole[:ROWS]) + "\n")
    offline, recording, estimate, live = live_and_offline(data, tmp_path, demo_config)
    assert_same(offline, recording)
    for error in (estimate["force_error"], live["slave"]["force_error"]):
        assert error["rmse_N"] <= 0.47
    hand = read_columns(recording, HAND.name)
    assert np.abs(hand["force"][:, 0]).max() > 0.5
