"""`teleop diagnose` of a table of an arm, with the arm's config."""

import json

import pytest

from studies.hidden import arms
from teleop.cli.commands import Parser
from teleop.cli.diagnose import command
from teleop.data.channel_names import ANCHOR_TENSION, JOINT_ANGLE, format_numbered_name
from teleop.data.table import Columns, write_table
from teleop.errors import UsageError

SHAPE = arms.Shape(((0.005, 0.0), (-0.004, 0.005)), friction=0.15, wrap=0.5)
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
        names = Columns.of_tendon(k + 1)
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
