import math
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from master import process
from master.config import MasterConfig
from master.devices.hid.mapping import AxisConfig, ButtonsConfig, HidConfig
from master.devices.hid.pid import PidConfig
from master.devices.ros_device import RosDeviceConfig
from master.devices.virtual import Reaches, VirtualConfig
from master.feedback import FeedbackConfig
from master.gate import GateConfig
from master.operator import OperatorConfig
from teleop.cli import commands
from teleop.config.loading import load
from teleop.errors import UsageError

DOCS = Path(__file__).parents[2] / "docs" / "how-to" / "haptic-device.md"
LIMITS = ("axis_max", "total_max", "slew_max")
CONFIGS = Path(__file__).parents[2] / "configs"


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
    assert device.pressed(9.0)
    assert not device.pressed(9.9)
    assert device.pressed(10.6)


@pytest.mark.parametrize(
    ("override", "complaint"),
    [
        ("master.force.scale=-1", "scale"),
        ("master.state_timeout=0.2", "delay_max"),
        ("master.device.type=falcon", "virtual"),
        ("master.device.mas=1", "mass"),
        ("master.device.reference.type=jump", "reaches"),
        ("master.device.engage=[[2, 1]]", "engage"),
        ("master.device={type: hid, axes: [{name: x}]}", "travel, speed"),
        ("master.device={type: hid, buttons: {engage: 0}}", "buttons.engage"),
        ("master.device={type: hid, find: 4711}", "quotes"),
    ],
)
def test_a_mistake_is_one_line_that_names_it(override, complaint):
    with pytest.raises(UsageError, match=complaint) as caught:
        load(None, MasterConfig, "master", [override])
    assert "\n" not in str(caught.value)


X, Y = AxisConfig("x", travel=0.1), AxisConfig("y", travel=0.1)
WRONG = [  # class, settings of which the first is refused by its name
    (AxisConfig, {"travel": 0.1, "speed": 0.1}),
    (AxisConfig, {"travel": 0.0}),
    (AxisConfig, {"dead_zone": 1.0, "travel": 0.1}),
    (AxisConfig, {"force": -1.0, "travel": 0.1}),
    (AxisConfig, {"joint": 8, "travel": 0.1}),
    (AxisConfig, {"name": "", "travel": 0.1}),
    (HidConfig, {"axes": ()}),
    (HidConfig, {"axes": (X, replace(Y, joint=0))}),
    (HidConfig, {"axes": (X, X)}),
    (HidConfig, {"smoothing": 1.0}),
    (ButtonsConfig, {"engage": 1, "clutch": 1}),
    (PidConfig, {"damper": math.nan}),
    (PidConfig, {"spring": 1.1}),
    (OperatorConfig, {"position_scale": 0.0}),
    (OperatorConfig, {"position_scale": math.nan}),
    (OperatorConfig, {"lock": (8,)}),
    (OperatorConfig, {"align": 0.0}),
    (OperatorConfig, {"presence": 0.0}),
    (OperatorConfig, {"presence_motion": 0.0}),
    (OperatorConfig, {"workspace": ((0.1, 0.1),)}),
    (OperatorConfig, {"workspace": ((math.nan, 1.0),)}),
    (OperatorConfig, {"wall": -1.0}),
    (OperatorConfig, {"wall_damping": math.nan}),
    (OperatorConfig, {"wall_max": 11.0}),
    (OperatorConfig, {"weight": (math.nan,)}),
    (OperatorConfig, {"weight": (0.0,) * 9}),
    (FeedbackConfig, {"scale": -0.1}),
    (FeedbackConfig, {"limit": math.inf}),
    (FeedbackConfig, {"slew": 0.0}),
    *((GateConfig, {name: value}) for name in LIMITS for value in (0.0, -1.0, math.inf, math.nan)),
    (VirtualConfig, {"axes": 9}),
    (VirtualConfig, {"mass": 0.0}),
    (VirtualConfig, {"damping": math.nan}),
    (VirtualConfig, {"axis_delay": -1.0}),
    (VirtualConfig, {"engage": ((0.5, 2.0), (1.0, 3.0))}),
    (VirtualConfig, {"engage": ((math.nan, 2.0),)}),
    (VirtualConfig, {"engage_period": 0.0}),
    (RosDeviceConfig, {"axes": 4, "command": "servo_cv"}),
    (RosDeviceConfig, {"timeout": 2.0}),
    (RosDeviceConfig, {"speed_max": math.nan}),
    (RosDeviceConfig, {"position_max": 0.0}),
    (RosDeviceConfig, {"rate_max": 1.0}),
    (RosDeviceConfig, {"domain": -1}),
    (RosDeviceConfig, {"router": "tcp/10.0.0.1:7447"}),
    (RosDeviceConfig, {"prefix": "lab"}),
]


@pytest.mark.parametrize(("config", "settings"), WRONG)
def test_values_that_make_no_sense_are_refused_by_name(config, settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        config(**settings)


def test_the_master_of_every_config_that_comes_along_is_understood():
    paths = [path for path in CONFIGS.glob("*.yaml") if "\nmaster:" in path.read_text()]
    devices = {load(path, MasterConfig, "master").device.type for path in paths}
    assert devices == {"virtual", "hid", "combined"}


def test_the_help_shows_settings_that_exist():
    words = process.__doc__.split()
    settings = [words[i + 1] for i, word in enumerate(words) if word == "--set"]
    assert settings
    load(None, MasterConfig, "master", settings)


def test_a_hand_may_press_for_ever():
    config = load(None, MasterConfig, "master", ["master.device.engage=[[1, .inf]]"])
    assert config.device.engage == ((1.0, math.inf),)


def test_defaults_are_written_as_they_are_read(tmp_path):
    from teleop.config.loading import as_tree

    text = yaml.safe_dump({"master": as_tree(MasterConfig())})
    assert load(written(tmp_path, text), MasterConfig, "master") == MasterConfig()


@pytest.mark.parametrize(
    ("rate_hz", "device_rate_hz", "every"),
    [(1000.0, None, 1), (1000.0, 4000.0, 4), (100.0, 4000.0, 40)],
)
def test_a_command_is_sent_every_so_many_ticks_of_the_device(rate_hz, device_rate_hz, every):
    config = MasterConfig(device_rate_hz=device_rate_hz)
    config.check_rate(rate_hz)
    assert config.commands_every(rate_hz) == every


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
