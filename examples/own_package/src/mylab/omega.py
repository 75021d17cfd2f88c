"""A Force Dimension omega, delta or sigma, or a Novint Falcon, by the maker's SDK. Never tried.

pip install forcedimension-core, and the SDK of forcedimension.com with its udev rules
master: {device: {type: omega}, mapping: {type: space, hands: [{axes: [x, y, z]}]}}
"""

from dataclasses import dataclass

from master.device import DeviceFault, DeviceLost, HandState
from master.devices.extension import DeviceExtension

WATCHDOG = 240  # [125 us] without a force the firmware switches forces off: 30 ms


@dataclass(frozen=True)
class OmegaConfig(DeviceExtension):
    """Keys of `master.device` in the config."""

    engage_button: int = 0  # counted from 0, as in the SDK
    without_watchdog: bool = False  # accept that a force stays if the master is killed (Falcon)

    @property
    def axis_count(self) -> int:
        return 3

    def open(self) -> "Omega":
        return Omega(self)


class Omega:
    """Its calls wait for USB, a fraction of a millisecond each."""

    axes = 3

    def __init__(self, config: OmegaConfig) -> None:
        from forcedimension_core import dhd  # it loads the SDK

        self._dhd, self._button = dhd, config.engage_button
        self._position, self._velocity = [0.0] * 3, [0.0] * 3
        if dhd.open() < 0:
            raise DeviceFault(f"omega: cannot be opened: {dhd.errorGetLastStr()}")
        if dhd.expert.setWatchdog(WATCHDOG) < 0 and not config.without_watchdog:
            dhd.close()
            raise DeviceFault(
                "omega: it has no watchdog, so a force stays if the master is killed; to accept "
                "that, set master.device.without_watchdog"
            )
        dhd.enableForce(True)

    def read(self, _time_s: float) -> HandState:
        dhd = self._dhd
        pressed = dhd.getButton(self._button)
        if min(pressed, dhd.getPosition(self._position), dhd.getLinearVelocity(self._velocity)) < 0:
            raise DeviceLost(f"omega: {dhd.errorGetLastStr()}")
        return HandState(tuple(self._position), tuple(self._velocity), pressed == 1)

    def write(self, force: tuple[float, ...]) -> None:
        if self._dhd.setForce(force) < 0:
            raise DeviceLost(f"omega: {self._dhd.errorGetLastStr()}")

    def close(self) -> None:
        self._dhd.setForce((0.0, 0.0, 0.0))
        self._dhd.enableForce(False)
        self._dhd.close()
