"""`teleop diagnose` of a table of an arm, with the arm's config."""

import json
import math

import pytest

from slave.rigs.virtual_bench import MotionScale, simulate
from studies.hidden_effects import arms
from teleop.cli.commands import Parser
from teleop.cli.diagnose import command
from teleop.data.measured_table import Columns, write_table
from teleop.data.standard_columns import ANCHOR_TENSION, JOINT_ANGLE, format_numbered_name
from teleop.errors import UsageError
from teleop.messages.messages import MAX_TENDONS, TendonState
from teleop.messages.topics import TENDONS
from tests.teleop.recorded import START_NS, record

SHAPE = arms.Shape(((0.005, 0.0), (-0.004, 0.005)), friction=0.15, wrap=0.5)
FIELDS = ("time_s", "proximal_tension", "proximal_displacement", "bench_distal_tension",
          "bench_distal_displacement")  # fmt: skip
CONFIG = """
arms: [{radii: &radii [[0.005, 0.0], [-0.004, 0.005]], friction: 0.15, wrap: 0.5}]
slave:
  calibration: as-built
  rig:
    type: simulated
    arms: [{radii: *radii, friction: 0.15, wrap: 0.5}]
    joints:
      - tendons: [&tendon {sheath: {sections: &sections [
          {length: 0.4}, {length: 0.5, radius: 0.15}, {length: 0.4, radius: 0.4}
        ], friction: 0.14}}, *tendon]
      - tendons: [&other {sheath: {sections: *sections, friction: 0.15}}, *other]
"""


def run(*words):
    parser = Parser()
    command.add_arguments(parser)
    return command.main(parser.parse_args([str(word) for word in words]))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a table of an arm with a wrong sign in the routing, and its config."""
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.yaml").write_text(CONFIG)
    change = arms.Change("sign", joint=0, row=1)
    record = arms.make(SHAPE, change, seed=5, duration=12.0)
    columns = {"time_s": record.time}
    for k in range(4):
        names = Columns.from_tendon(k + 1)
        columns[names.proximal_tension] = record.proximal_tension[:, k]
        columns[names.proximal_displacement] = record.proximal_displacement[:, k]
        columns[format_numbered_name(ANCHOR_TENSION, k + 1)] = record.anchor_tension[:, k]
    columns |= {JOINT_ANGLE.format(j): angle for j, angle in enumerate(record.angles.T, 1)}
    write_table(folder / "arm.csv", columns)
    del columns["joint_angle_2_rad"]
    write_table(folder / "lacking.csv", columns)
    return folder


def test_a_wrong_sign_in_the_routing_is_named_with_joint_and_tendons(files, capsys):
    out = files / "out"
    assert run(files / "arm.csv", "--config", files / "arm.yaml", "--out", out) == 0
    assert "joint 1 moves tendons 2a and 2b the other way" in capsys.readouterr().out
    report = json.loads((out / "report.json").read_text())
    (cause,) = report["causes"]
    assert (cause["name"], cause["joint"], cause["tendons"]) == ("coupling", 1, ["2a", "2b"])
    assert cause["low"] < 0.008 < cause["high"] + 2e-5
    assert "wrong sign" in (out / "report.html").read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["arm.csv", "--config", "none.yaml"], "has no arms"),
        (["lacking.csv", "--config", "arm.yaml"], "no column 'joint_angle_2_rad'"),
        (["arm.csv", "arm.csv", "--config", "arm.yaml"], "one file is diagnosed at a time"),
        (["arm.csv", "--config", "arm.yaml", "--fit-all"], "--fit-all: is for one tendon"),
    ],
)
def test_what_cannot_be_diagnosed_is_refused_in_a_line(files, words, message):
    (files / "none.yaml").write_text("rate_hz: 1000\n")
    with pytest.raises(UsageError, match=message):
        run(*(files / word if "." in word else word for word in words))


def test_a_recording_is_diagnosed_with_the_arm_of_its_own_config(tmp_path, capsys):
    scale = MotionScale(stroke=0.006, period=3.0)
    config = arms.describe_rig(SHAPE, arms.Change(), seed=3)
    run_ = simulate(config, "sine", duration=12.0, rate=100.0, scale=scale, keep=2.0)
    columns = run_.to_columns()
    travel = 0.005 * columns["joint_angle_2_rad"] - 0.004 * columns["joint_angle_1_rad"]
    assert columns["distal_displacement_3_m"] == pytest.approx(travel, abs=5e-5)  # it stretches
    assert columns["anchor_tension_3_N"].max() != columns["distal_tension_3_N"].max()

    def fill(values):
        return (*values.tolist(), *(math.nan,) * (MAX_TENDONS - 4))

    messages = []
    for row in zip(*run_[:5], strict=True):
        fields = dict(zip(FIELDS, (float(row[0]), *map(fill, row[1:])), strict=True))
        sent_ns = START_NS + round(row[0] * 1e9)
        messages.append((TENDONS, TendonState(tendons=4, **fields), sent_ns))
    assert run(record(tmp_path, messages, CONFIG)) == 0
    printed = capsys.readouterr().out
    assert "Nothing is wrong with the arm" in printed
    assert "Joint angles were not measured" in printed
