import math
from dataclasses import replace
from pathlib import Path

import pytest

from master.config import MasterConfig
from master.devices.hid.input_map import AxisConfig, ButtonsConfig, HidConfig
from master.devices.hid.pid import PidConfig
from master.devices.ros_device import RosDeviceConfig
from master.devices.virtual import Reaches, VirtualConfig
from master.feedback import FeedbackConfig
from master.gate import GateConfig
from master.operator import OperatorConfig
from teleop.cli import commands
from teleop.config.loading import load

DOCS = Path(__file__).parents[2] / "docs" / "how-to" / "haptic-device.md"
LIMITS = ("axis_max", "total_max", "slew_max")


def written(tmp_path, text):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    return path


def examples(tmp_path):
    for text in DOCS.read_text().split("```yaml\n")[1:]:
        yield load(written(tmp_path, text.split("```")[0]), MasterConfig, "master").device


def test_the_examples_in_the_docs_are_configs(tmp_path):
    hid, combined, device = examples(tmp_path)
    assert [part.axis_count for part in combined.devices] == [2, 2]
    assert hid.axes == (
        AxisConfig("x", travel=0.06, force=2.5),
        AxisConfig("y", joint=1, speed=0.02, dead_zone=0.1),
    )
    assert (hid.find, hid.buttons) == ("1209:ffb0", ButtonsConfig(1, 2, 3))
    assert device.reference == Reaches()
    assert device.engage == ((0.5, 9.5),)
    assert device.is_pressed(9.0)
    assert not device.is_pressed(9.9)
    assert device.is_pressed(10.6)


X, Y = AxisConfig("x", travel=0.1), AxisConfig("y", travel=0.1)
WRONG = [  # class, settings of which the first is refused by its name
    (AxisConfig, {"travel": 0.1, "speed": 0.1}),
    (AxisConfig, {"dead_zone": 1.0, "travel": 0.1}),
    (AxisConfig, {"joint": 8, "travel": 0.1}),
    (HidConfig, {"axes": (X, replace(Y, joint=0))}),
    (HidConfig, {"axes": (X, X)}),
    (ButtonsConfig, {"engage": 1, "clutch": 1}),
    (PidConfig, {"damper": math.nan}),
    (OperatorConfig, {"position_scale": math.nan}),
    (OperatorConfig, {"lock": (8,)}),
    (OperatorConfig, {"workspace": ((0.1, 0.1),)}),
    (OperatorConfig, {"wall_max": 11.0}),
    (OperatorConfig, {"weight": (0.0,) * 9}),
    (FeedbackConfig, {"limit": math.inf}),
    *((GateConfig, {name: value}) for name in LIMITS for value in (0.0, -1.0, math.inf, math.nan)),
    (VirtualConfig, {"axes": 9}),
    (VirtualConfig, {"engage": ((0.5, 2.0), (1.0, 3.0))}),
    (RosDeviceConfig, {"axes": 4, "command": "servo_cv"}),
    (RosDeviceConfig, {"speed_max": math.nan}),
    (RosDeviceConfig, {"router": "tcp/10.0.0.1:7447"}),
]


@pytest.mark.parametrize(("config", "settings"), WRONG)
def test_values_that_make_no_sense_are_refused_by_name(config, settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        config(**settings)


@pytest.mark.parametrize(
    ("rate_hz", "device_rate_hz", "every"),
    [(1000.0, None, 1), (1000.0, 4000.0, 4), (100.0, 4000.0, 40)],
)
def test_a_command_is_sent_every_so_many_ticks_of_the_device(rate_hz, device_rate_hz, every):
    config = MasterConfig(device_rate_hz=device_rate_hz)
    config.check_rate(rate_hz)
    assert config.count_ticks_per_command(rate_hz) == every


@pytest.mark.parametrize(
    ("overrides", "complaint"),
    [
        (
            ["master.device_rate_hz=2500"],
            "master.device_rate_hz: 2500: must be an integer multiple of rate_hz (1000 Hz)",
        ),
        (
            ["master.device_rate_hz=8000"],
            "--set master.device_rate_hz=8000: master.device_rate_hz: 8000.0: must be 100 to "
            "4000 Hz",
        ),
        (
            ["rate_hz=100"],
            "slave.command_timeout: 0.028: must be at least 3 periods of rate_hz (0.03 s at "
            "100 Hz)",
        ),
        (
            ["rate_hz=100", "slave.command_timeout=0.04", "master.state_timeout=0.02"],
            "master.state_timeout: 0.02: must be at least 3 periods of rate_hz (0.03 s at 100 Hz)",
        ),
    ],
)
def test_a_rate_that_does_not_go_with_the_rest_is_one_line_before_anything_starts(
    overrides, complaint, capsys
):
    words = [word for override in overrides for word in ("--set", override)]
    concerned = {complaint.removeprefix("--set ").partition(".")[0], "run"}
    for command in sorted(concerned):
        assert commands.main([command, *words]) == 2
        assert capsys.readouterr().err.strip().removeprefix("teleop: ") == complaint
