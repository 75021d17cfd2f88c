"""The configs of single haptic devices."""

from master.devices.extension import DeviceExtension
from master.devices.hid.config import HidConfig
from master.devices.ros.config import RosDeviceConfig
from master.devices.virtual import VirtualConfig

# all of them, joined by `|`; the key `type` in a config chooses
SingleConfig = VirtualConfig | HidConfig | RosDeviceConfig | DeviceExtension
