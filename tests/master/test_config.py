import math
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

from master import devices
from master.config import MasterConfig
from master.device import DeviceFault
from master.devices import open_device
from master.devices.combined import CombinedConfig
from master.devices.extension import DeviceExtension
from master.devices.hid.mapping import AxisConfig, ButtonsConfig
from master.devices.virtual import Reaches, VirtualConfig
from teleop.cli import commands
from teleop.config.loading import load
from teleop.errors import UsageError

DOCS = Path(__file__).parents[2] / "docs" / "devices.md"
CONFIGS = Path(__file__).parents[2] / "configs"


def written(tmp_path, text):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    return path


def test_without_a_file_everything_has_a_default():
    assert load(None, MasterConfig, "master") == MasterConfig()


def examples(tmp_path):
    """The devices of the examples in the docs."""
    for text in DOCS.read_text().split("```yaml\n")[1:]:
        yield load(written(tmp_path, text.split("```")[0]), MasterConfig, "master").device


def test_the_examples_in_the_docs_are_configs(tmp_path):
    device, combined, hid = examples(tmp_path)
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


def test_the_new_device_in_the_docs_takes_less_than_50_lines_and_runs():
    (block,) = DOCS.read_text().split("```python\n")[1:]
    driver = block.split("```")[0]
    assert len([line for line in driver.splitlines() if line.strip()]) < 50
    scope = {"__name__": "example"}
    exec(compile(driver, "example", "exec"), scope)  # noqa: S102 - our own page
    assert issubclass(scope["ExampleConfig"], DeviceExtension)
    assert scope["ExampleDevice"].axes == scope["ExampleConfig"]().axis_count == 1
    with pytest.raises(ValueError, match="port"):
        scope["ExampleConfig"](port="COM3")


@pytest.mark.parametrize(
    ("override", "complaint"),
    [
        ("master.force.scale=-1", "scale"),
        ("master.gate.axis_max=0", "axis_max"),
        ("master.state_timeout=0", "state_timeout"),
        ("master.state_timeout=0.2", "delay_max"),
        ("master.device.type=falcon", "virtual"),
        ("master.device.mas=1", "mass"),
        ("master.device.reference.type=jump", "reaches"),
        ("master.device.engage=[[2, 1]]", "engage"),
        ("master.device={type: hid, axes: [{name: x}]}", "travel, speed"),
        ("master.device={type: hid, driver: usb}", "spacemouse"),
        ("master.device={type: hid, buttons: {engage: 0}}", "buttons.engage"),
        ("master.device={type: hid, find: 4711}", "quotes"),
        ("master.operator.position_scale=0", "position_scale"),
    ],
)
def test_a_mistake_is_one_line_that_names_it(override, complaint):
    with pytest.raises(UsageError, match=complaint) as caught:
        load(None, MasterConfig, "master", [override])
    assert "\n" not in str(caught.value)


def test_the_master_of_every_config_that_comes_along_is_understood():
    paths = [path for path in CONFIGS.glob("*.yaml") if "\nmaster:" in path.read_text()]
    devices = {load(path, MasterConfig, "master").device.type for path in paths}
    assert devices == {"virtual", "hid", "combined"}


def test_a_hand_may_press_for_ever():
    config = load(None, MasterConfig, "master", ["master.device.engage=[[1, .inf]]"])
    assert config.device.engage == ((1.0, math.inf),)


def test_a_device_that_is_not_there_is_a_usage_error(monkeypatch):
    def missing(config):
        raise DeviceFault("no such device")

    monkeypatch.setitem(devices.DEVICES, VirtualConfig, missing)
    with pytest.raises(UsageError, match=r"^master\.device: no such device$"):
        open_device(VirtualConfig())


class Misfit:
    """A device that was opened with as many axes as it likes."""

    def __init__(self, axes):
        self.axes, self.closed = axes, 0

    def read(self, _):
        raise AssertionError

    def write(self, _):
        raise AssertionError

    def close(self):
        self.closed += 1


@dataclass(frozen=True)
class MisfitConfig(DeviceExtension):
    """Its `axis_count` is 1, whatever it opens."""

    type: str = "mylab"
    device: Misfit | None = None

    def open(self):
        return self.device


@pytest.mark.parametrize("axes", [-1, 0, 9])
def test_a_device_whose_axes_are_no_joints_is_named_and_closed(axes):
    device = Misfit(axes)
    with pytest.raises(
        UsageError, match=rf"^master\.device: mylab has {axes} axes, must be 1 to 8$"
    ):
        open_device(MisfitConfig(device=device))
    assert device.closed == 1


@pytest.mark.parametrize("axes", [0, 6])
def test_devices_that_have_more_axes_together_than_joints_are_named_and_closed(axes):
    parts = [Misfit(3), Misfit(axes)]
    config = CombinedConfig(devices=tuple(MisfitConfig(device=part) for part in parts))
    with pytest.raises(
        UsageError, match=rf"^master\.device: devices\.1: mylab has {axes} axes, must be 1 to 5$"
    ):
        open_device(config)
    assert [part.closed for part in parts] == [1, 1]


def test_defaults_are_written_as_they_are_read(tmp_path):
    from teleop.config.loading import as_tree

    text = yaml.safe_dump({"master": as_tree(MasterConfig())})
    assert load(written(tmp_path, text), MasterConfig, "master") == MasterConfig()


@pytest.mark.parametrize(
    ("rate_hz", "device_rate_hz", "every"),
    [(1000.0, None, 1), (1000.0, 1000.0, 1), (1000.0, 4000.0, 4), (100.0, 4000.0, 40)],
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
            ["master.device_rate_hz=500"],
            "master.device_rate_hz: 500: must be an integer multiple of rate_hz (1000 Hz)",
        ),
        (
            ["master.device_rate_hz=8000"],
            "--set master.device_rate_hz=8000: master.device_rate_hz: 8000.0: must be within "
            "100 ... 4000 [Hz]",
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
        (
            ["rate_hz=100", "slave.command_timeout=0.04", "slave.gate.tension_age_max=0.02"],
            "slave.gate.tension_age_max: 0.02: must be at least 3 periods of rate_hz (0.03 s at "
            "100 Hz)",
        ),
        (
            ["slave.sample_timeout=0.002"],
            "slave.sample_timeout: 0.002: must be at least 3 periods of rate_hz (0.003 s at "
            "1000 Hz)",
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
