"""A recording brings the config of its session along: models, names of tendons, the view."""

import json
import math

import numpy as np
import pytest

from slave.config import SlaveConfig
from teleop.cli import commands
from teleop.config.loading import load
from teleop.data.measured_table import read_table
from teleop.link import LinkConfig
from teleop.messages.messages import MAX_TENDONS, TendonState
from teleop.messages.topics import TENDONS
from teleop.session.config import RunConfig
from teleop.view.config import ViewConfig
from tests.root import ROOT
from tests.teleop import recorded
from tests.teleop.recorded import START_NS

SAMPLES = 400
NOWHERE = (math.nan,) * MAX_TENDONS


def record(folder, config, *overrides, tendons=8):
    """A recording of tendons that are pulled and released, tendon k to k + 1 newtons."""
    text = (ROOT / "configs" / config).read_text() if config else ""
    messages = []
    for k in range(SAMPLES):
        pull = 1.0 - math.cos(2.0 * math.pi * k / SAMPLES)
        state = TendonState(
            tendons=tendons,
            time_s=k * 1e-3,
            proximal_tension=tuple(2.0 + 0.5 * pull * (i + 1) for i in range(MAX_TENDONS)),
            proximal_displacement=NOWHERE,
            bench_distal_tension=NOWHERE,
            bench_distal_displacement=NOWHERE,
        )
        messages.append((TENDONS, state, START_NS + k * 1_000_000))
    return recorded.record(folder, messages, text, overrides)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    here = ["session=arm-1234", "link.master=127.0.0.1:1", "rate_hz=500", "view.tension_scale_N=9"]
    friction = "slave.rig.joints.3.tendons.0.sheath.friction=0.25"
    return record(tmp_path_factory.mktemp("arm"), "arm.yaml", *here, friction)


def test_a_recording_is_a_config_but_for_where_its_session_ran(arm):
    shared = load(arm, RunConfig, None)
    assert (shared.session, shared.link) == (RunConfig().session, LinkConfig())
    assert shared.rate_hz == 500.0
    assert load(arm, ViewConfig, "view").tension_scale_N == 9.0
    slave = load(arm, SlaveConfig, "slave", ["slave.rig.seed=7"])
    assert len(slave.rig.joints) == 4
    assert slave.rig.joints[3].tendons[0].sheath.friction == 0.25
    assert slave.rig.seed == 7


def test_its_models_and_names_of_tendons_are_those_of_the_session(arm, tmp_path, refused):
    def model(*words):
        out = tmp_path / "summary.json"
        assert commands.main(["estimate", *map(str, words), "--json", str(out), "--force"]) == 0
        return json.loads(out.read_text())["model"]

    assert model(arm, "--tendon", "4a") == model(arm, "--tendon", "7")
    assert model(arm, "--tendon", "4a") != model(arm, "--tendon", "4b")
    with_config = model(arm, "--tendon", "4b", "--config", ROOT / "configs" / "arm.yaml")
    assert model(arm, "--tendon", "4b") == with_config
    for command in (["estimate"], ["diagnose"], ["estimate", "--fit"]):
        names = ", ".join([f"{joint}{side}" for joint in "1234" for side in "ab"])
        said = f"teleop: --tendon 9: must be one of {names}, 1, 2, 3, 4, 5, 6, 7, 8"
        assert refused(*command, arm, "--tendon", "9") == said


def test_each_tendon_is_written_into_columns_of_its_own(arm, tmp_path):
    out = tmp_path / "estimates.csv"
    assert commands.main(["estimate", str(arm), "--tendon", "7", "--out", str(out)]) == 0
    first, seventh = read_table(arm), read_table(out).extra
    assert np.array_equal(read_table(out).proximal_tension, first.proximal_tension)
    assert max(seventh["proximal_tension_7_N"]) == pytest.approx(9.0)
    named = ["distal_tension_estimate_7_N", "distal_tension_low_7_N", "front_7_m", "status_7"]
    assert set(named) <= set(seventh)
    assert not {"distal_tension_estimate_N", "status"} & set(seventh)


def test_a_session_on_defaults_has_a_config_too(tmp_path, refused):
    path = record(tmp_path, "", tendons=1)
    assert "slave.tendons" in refused("estimate", path)  # a slave without a calibration


def test_a_calibration_that_the_recording_only_names_is_asked_for(tmp_path, refused):
    path = record(tmp_path, "arm.yaml", "slave.calibration=mine.yaml")
    said = f"{path} was recorded with it; --calibration FILE names another"
    assert said in refused("estimate", path)
    path = record(tmp_path / "at-start", "arm.yaml", "slave.initialise.at_start=true")
    assert "calibrated its rig at its start" in refused("estimate", path)
