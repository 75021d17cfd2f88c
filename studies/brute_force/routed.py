"""A tendon behind its sheath, over guides at the joints of an arm: a chain of Coulomb beads.

The beads of the sheath and of all guides obey what those of `chain.Chain` obey, and nothing else is
known here: no law of a whole bend, no memory but where the material of the tendon is. `travel` of a
bead is the material that has passed it towards the motor, so a bead is a place on its guide, not a
piece of the tendon.

Along a pin the beads are a fixed pitch apart. When its joint turns, beads at the end that the arm
moves come into contact or lose it, and the path between the last bead and the next guide becomes
longer or shorter. What comes into contact has the strain of the stretch it lay in; two stretches
between which a bead vanished become one. A curved section keeps its beads, and turning changes the
angle of each and the path between them.
"""

from dataclasses import dataclass

import numpy as np

from studies.brute_force.chain import Chain, Force, Position


@dataclass(frozen=True)
class Pin:
    """A pin or pulley that does not turn, on the axis of a joint."""

    joint: int  # whose angle turns one end of the contact
    arm: float  # [m] what 1 rad of the joint pulls in of the tendon; |arm| is the pin's radius
    friction: float
    wrap: float  # [rad] contact at joint angle 0; it falls as a positive `arm` pulls in
    span: float  # [m] of tendon from here to the next guide
    on_distal_link: bool = False  # it turns with that: its near end gains and loses contact
    beads_per_rad: float = 20.0


@dataclass(frozen=True)
class Bend:
    """A curved section: its angle |wrap + side joint angle| spreads over its `length` [m]."""

    joint: int
    arm: float
    friction: float
    wrap: float
    span: float
    length: float
    side: float = 1.0
    beads: int = 16


class RoutedChain(Chain):
    """The chain; `move_to` takes it to the next tension at the motor and the next joint angles."""

    def __init__(self, sections, friction, axial_stiffness, guides, angles, tension, *, beads=60):
        """Lay a sheath of (length, radius) sections, then `guides` in the order of the tendon."""
        super().__init__(sections, friction, axial_stiffness, beads=beads, tension=tension)
        self.axial_stiffness = axial_stiffness
        self.guides = guides
        self.sheath_limits = self.limit_motor
        self.sheath_places = np.cumsum(self.lengths)[:-1]
        self.start = np.sum(self.lengths)
        self.angles = np.array(angles, float)
        self.names, limits, places, end = self._layout(self.angles)
        self.end_reference = end  # places at first, which travel is counted from
        self.references = dict(zip(self.names, places, strict=True))
        self.sliding = np.zeros(len(self.names), dtype=int)
        self.limit_motor = self.limit_tip = limits
        strain = tension / axial_stiffness
        # material label of a place x is x / (1 + strain), of the same zero for all that follows
        nodes = np.concatenate([[0.0], places, [end]])
        self.travel = -strain * nodes
        self._lay_springs(places, end)

    def _layout(self, angles):
        """Return name, friction times angle and place of each bead in contact, and the end."""
        names = [("sheath", i) for i in range(len(self.sheath_places))]
        limits, places, x = [*self.sheath_limits], [*self.sheath_places], self.start
        for index, guide in enumerate(self.guides):
            angle = angles[guide.joint]
            if isinstance(guide, Bend):
                path = guide.length - guide.arm * angle
                bend = abs(guide.wrap + guide.side * angle)
                for i in range(guide.beads):
                    names.append((index, i))
                    limits.append(guide.friction * bend / guide.beads)
                    places.append(x + (i + 0.5) * path / guide.beads)
            else:
                radius = abs(guide.arm)
                contact = guide.wrap - np.sign(guide.arm) * angle
                path, pitch = radius * contact, 1.0 / guide.beads_per_rad
                count = int(contact / pitch + 0.5)
                assert count > 0, "a pin has lost its tendon"
                order = reversed(range(count)) if guide.on_distal_link else range(count)
                for i in order:
                    names.append((index, i))
                    turned = pitch if i < count - 1 else contact - i * pitch
                    limits.append(guide.friction * turned)
                    from_fixed_end = radius * (i + 0.5) * pitch
                    places.append(x + (path - from_fixed_end if guide.on_distal_link
                                       else from_fixed_end))  # fmt: skip
            x += path + guide.span
        return names, np.array(limits), np.array(places), x

    def _lay_springs(self, places, end):
        nodes = np.concatenate([[0.0], places, [end]])
        self.lengths = np.diff(nodes)
        self.stiffness = self.axial_stiffness / self.lengths
        labels = [self.references[name] for name in self.names]
        self.offset = self.stiffness * (
            self.lengths - np.diff(np.concatenate([[0.0], labels, [self.end_reference]]))
        )

    def move_to(self, tension, angles):
        """Bring the motor to `tension` [N] and the joints to `angles` [rad]."""
        self._step(np.array([tension, *angles]))

    def _step(self, target, halvings=10):
        """Take one step, or where no equilibrium is found the same way in two."""
        state = dict(vars(self), references=dict(self.references))
        start = np.array([self.T_in, *self.angles])
        try:
            self._turn(target[1:])
            self.move(Force(target[0]), Position(self.travel[-1]))
        except AssertionError:
            if halvings == 0:
                raise
            vars(self).update(state)
            self._step((start + target) / 2, halvings - 1)
            self._step(target, halvings - 1)

    def _turn(self, angles):
        """Turn the joints: contact comes and goes, the material stays where it is."""
        names, limits, places, end = self._layout(angles)
        known = dict(zip(self.names, range(len(self.names)), strict=True))
        before = {name: self.travel[1 + i] for name, i in known.items()}
        sliding = {name: self.sliding[i] for name, i in known.items()}
        kept = [i for i, name in enumerate(names) if name in known]
        at = np.concatenate([[0.0], places[kept], [end]])
        old = [self.references[names[i]] + before[names[i]] for i in kept]
        old = np.concatenate([[self.travel[0]], old, [self.end_reference + self.travel[-1]]])
        # what comes into contact has the strain of the stretch it lay in
        for i, name in enumerate(names):
            if name not in before:
                label = float(np.interp(places[i], at, old))
                self.references.setdefault(name, label)
                before[name] = label - self.references[name]
        self.names, self.angles = names, np.array(angles, float)
        self.limit_motor = self.limit_tip = limits
        self.sliding = np.array([sliding.get(name, 0) for name in names], dtype=int)
        self.travel = np.array([self.travel[0], *(before[n] for n in names), self.travel[-1]])
        self._lay_springs(places, end)

    @property
    def sheath_end_tension(self):
        """Tension between sheath and first guide [N]."""
        return self.tensions[len(self.sheath_places)]

    @property
    def guide_tensions(self):
        """Tension after each guide [N]."""
        tensions, last = self.tensions, {}
        for i, (index, _) in enumerate(self.names):
            last[index] = tensions[i + 1]
        return np.array([last[index] for index in range(len(self.guides))])

    @property
    def motor_travel(self):
        """Travel at the motor since the start [m], positive towards the motor."""
        return self.travel[0]

    def torque(self, joints):
        """Return the torque on each joint [N m], by virtual work: what it shortens of each stretch.

        The stretches are compared over a turn to whichever side leaves the beads in contact.
        """
        turn, tensions = 1e-6, self.tensions
        torque = np.zeros(joints)
        for joint in range(joints):
            ends = []
            for sign in (1, -1):
                angles = self.angles.copy()
                angles[joint] += sign * turn
                names, _, places, end = self._layout(angles)
                if names == self.names:
                    ends.append((sign, np.diff([0.0, *places, end])))
            sides = [sign for sign, _ in ends]
            longer = sum(sign * lengths for sign, lengths in ends)
            if len(ends) == 1:
                longer -= sides[0] * self.lengths
            torque[joint] = -tensions @ longer / (turn * len(ends))
        return torque
