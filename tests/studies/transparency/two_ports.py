"""Systems whose behaviour is known in closed form: the ground truth."""

import math
from collections import deque

import numpy as np

from studies.transparency.hand import DT
from studies.transparency.system import Answer


class VirtualWall:
    """A sampled spring, held for a tick."""

    def __init__(self, stiffness, contact=0.0):
        self._stiffness, self._contact = stiffness, contact

    def tick(self, hand, _push):
        x = hand.position[0]
        return Answer(-self._stiffness * max(x - self._contact, 0.0), x, 0.0)


class DelayedSpringDamper:
    """The tip hangs on the delayed hand by a spring and a damper; its load comes back delayed.

    With a drag B on the hand besides, T1 forward and T2 back, whole ticks:

        h11 = B H e,  h12 = b H exp(-s T2),  h21 = -a C exp(-s T1),  h22 = s / (k + d s)

    Forces are held, H = sin(w T/2) / (w T/2), which delays what is not delayed by e = exp(-s T/2);
    the hand's motion is taken as straight between two samples, C = cos(w T/2).
    """

    a, b = 0.5, 0.3
    k, d, drag = 400.0, 8.0, 2.0  # [N/m], [N s/m], [N s/m]
    there, back = 40, 25  # ticks

    def __init__(self):
        self._hand = deque([0.0] * (self.there + 1), self.there + 1)
        self._load = deque([0.0] * (self.back + 1), self.back + 1)
        self._stretch = self._was = 0.0

    def tick(self, hand, push):
        x = hand.position[0]
        self._hand.append(x)
        self._load.append(push)
        # k y + d y' = push, exactly for a push that is straight in between
        rate, slope = self.k / self.d, (push - self._was) / DT
        rest = (self._was - slope / rate) / self.k
        self._stretch = (self._stretch - rest) * math.exp(-rate * DT) + rest + slope * DT / self.k
        self._was = push
        # told half a tick after the hand: straight on between two samples of it
        at_half = 0.5 * (self._hand[0] + self._hand[1])
        force = -self.b * self._load[0] - self.drag * hand.velocity[0]
        return Answer(force, self.a * at_half - self._stretch, push)

    @classmethod
    def parameters(cls, frequency):
        s, half = 2j * np.pi * frequency, np.pi * frequency * DT
        hold = np.sin(half) / half
        return {
            "h11": cls.drag * hold * np.exp(-s * DT / 2),
            "h12": cls.b * hold * np.exp(-s * cls.back * DT),
            "h21": -cls.a * np.cos(half) * np.exp(-s * cls.there * DT),
            "h22": s / (cls.k + cls.d * s),
        }
