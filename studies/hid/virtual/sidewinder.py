"""A SideWinder Force Feedback Pro on its USB adapter: centres by itself until Stop All Effects.

Facts read from the adapter's source (github.com/tloimu/adapt-ffb-joy: ffb-pro.c, ffb.c, ffb.h): a
reset frees all effects, enables the motors, ends a pause and starts a spring towards the middle,
and so does power on; only Stop All Effects ends the spring. The state has a safety switch and
power, both on. The adapter keeps that state and does not send it; this device does. The layout of
its reports is taken from the Arduino library, whose code began as the adapter's; the stiffness of
the spring is a guess.
"""

from studies.hid.virtual.arduino import Arduino

_ENABLE, _DISABLE, _STOP_ALL, _RESET, _PAUSE, _CONTINUE = 1, 2, 3, 4, 5, 6
_PAUSED, _ENABLED, _SAFETY, _OVERRIDE, _POWER = (1 << bit for bit in range(5))
CENTRING = 0.2  # share of full force at the end of the way


class SideWinder(Arduino):
    """Two axes; `centres` is whether its own spring acts."""

    name = "Microsoft SideWinder Force Feedback Pro (adapter)"
    vendor, product, serial = 0x03EB, 0x204E, "virtual-sidewinder"

    def __init__(self, descriptor: bytes) -> None:
        super().__init__(descriptor)
        self.centres = self.enabled = True
        self.paused = False

    def build_state(self) -> bytes:
        flags = (
            (_PAUSED if self.paused else 0)
            | (_ENABLED if self.enabled else 0)
            | (_SAFETY if self.safety else 0)
            | (_POWER if self.powered else 0)
        )
        return bytes((0x02, flags | _OVERRIDE, 0))

    def control_device(self, report: bytes) -> None:
        command = report[1]
        if command == _ENABLE:
            self.enabled = True
        elif command == _DISABLE:
            self.enabled = False
        elif command == _STOP_ALL:
            self.stop_all()
            self.centres = False
        elif command == _RESET:
            self.effects.clear()
            self.enabled, self.paused, self.centres = True, False, True
        elif command == _PAUSE:
            self.paused = True
        elif command == _CONTINUE:
            self.paused = False
        self.active = self.enabled and not self.paused

    def compute_force(self, now: float) -> tuple[float, ...]:
        pushed = super().compute_force(now)
        if not (self.centres and self.enabled and self.powered and self.safety):
            return pushed
        return tuple(
            max(-1.0, min(1.0, share - CENTRING * place)) + 0.0
            for share, place in zip(pushed, self.axes, strict=True)
        )
