"""Effects at the ends of a tendon: initial tension, pulleys, joint and environment."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal

from slave.simulation.effects.effect import Effect
from slave.simulation.environment import LoadMotorConfig, build_environment, merge_environments
from slave.simulation.joint import Joint, Tendon
from teleop.config.ranges import build_ranged_field


@dataclass(frozen=True, slots=True)
class JointEffect(Effect, ABC):
    """An effect in the physics of a joint."""

    @abstractmethod
    def apply(self, joint: Joint, travel: float, /) -> Joint:
        """Return the joint with this effect added; it was at `travel` [m] at its start."""


@dataclass(frozen=True, slots=True)
class SideEffect(JointEffect, ABC):
    """An effect in the physics of one tendon of a joint, or of both."""

    tendon: Literal["a", "b", "both"] = "both"  # of the joint, on which it acts

    def apply(self, joint: Joint, _travel: float, /) -> Joint:
        if self.tendon in ("a", "both"):
            joint = joint._replace(a=self.change(joint.a))
        if self.tendon in ("b", "both") and joint.pair:
            joint = joint._replace(b=self.change(joint.b))
        return joint

    @abstractmethod
    def change(self, tendon: Tendon, /) -> Tendon:
        """Return the tendon with this effect added."""


@dataclass(frozen=True, slots=True)
class JointFriction(JointEffect):
    """Dry friction of the joint itself, load-independent."""

    type: Literal["joint_friction"] = "joint_friction"
    friction: float = build_ranged_field(0.5, 0.0, 100.0, "N")  # Coulomb, dry

    def apply(self, joint: Joint, _travel: float, /) -> Joint:
        return joint._replace(
            body=joint.body._replace(friction=joint.body.friction + self.friction)
        )


@dataclass(frozen=True, slots=True)
class JointBacklash(JointEffect):
    """Play between the pulley that the tendons turn and the link, where the bench encoder is."""

    type: Literal["joint_backlash"] = "joint_backlash"
    play: float = build_ranged_field(1e-4, 0.0, 0.01, "m")  # between pulley and link

    def apply(self, joint: Joint, _travel: float, /) -> Joint:
        return joint._replace(body=joint.body._replace(backlash=joint.body.backlash + self.play))


@dataclass(frozen=True, slots=True)
class TipInertia(JointEffect):
    """A mass at the tip."""

    type: Literal["tip_inertia"] = "tip_inertia"
    mass: float = build_ranged_field(0.5, 0.0, 100.0, "kg")  # added to that of the joint

    def apply(self, joint: Joint, _travel: float, /) -> Joint:
        return joint._replace(body=joint.body._replace(mass=joint.body.mass + self.mass))


@dataclass(frozen=True, slots=True)
class TipMotion(JointEffect):
    """An external grip takes the tip where it is, moves it, holds it and releases it."""

    type: Literal["tip_moved"] = "tip_moved"
    travel: float = build_ranged_field(2e-3, -0.1, 0.1, "m")  # by which the grip moves the tip
    speed: float = build_ranged_field(0.01, 1e-5, 1.0, "m/s")  # of that motion
    stiffness: float = build_ranged_field(20_000.0, 1.0, 1e6, "N/m")  # of the hold
    hold: float = build_ranged_field(1.0, 0.0, 1e5, "s")  # before the release

    def apply(self, joint: Joint, travel: float, /) -> Joint:
        arrival = self.start + max(abs(self.travel) / self.speed, 1e-6)
        hand = LoadMotorConfig(
            mode="position",
            profile=((self.start, travel), (arrival, travel + self.travel)),
            stiffness=self.stiffness,
            coupled=(self.start, arrival + self.hold),
        )
        environment = merge_environments(joint.environment, build_environment(hand))
        return joint._replace(environment=environment)


@dataclass(frozen=True, slots=True)
class Pretension(SideEffect):
    """More initial tension than configured; a return spring balances it."""

    type: Literal["pretension"] = "pretension"
    tension: float = build_ranged_field(5.0, 0.0, 50.0, "N")  # added to the configured one

    def __post_init__(self) -> None:
        SideEffect.__post_init__(self)
        if self.start != 0.0:
            raise ValueError("start: must be 0 s for pretension")

    def apply(self, joint: Joint, travel: float, /) -> Joint:
        joint = SideEffect.apply(self, joint, travel)
        if joint.pair:
            return joint
        return joint._replace(
            body=joint.body._replace(pull_back=joint.body.pull_back + self.tension)
        )

    def change(self, tendon: Tendon, /) -> Tendon:
        chain, motor = tendon.chain, tendon.motor
        return tendon._replace(
            chain=chain._replace(pretension=chain.pretension + self.tension),
            motor=motor._replace(hold=motor.hold + self.tension),
        )


@dataclass(frozen=True, slots=True)
class AntagonistTension(JointEffect):
    """The other tendon of a pair is tighter than its motor knows.

    It is wound in by the length that raises a blocked tendon's tension by `tension`. A controller
    with a load cell pays it out again.
    """

    type: Literal["antagonist_tension"] = "antagonist_tension"
    tension: float = build_ranged_field(1.0, 0.0, 50.0, "N")  # by which it is tighter
    tendon: Literal["a", "b"] = "b"  # the tighter one

    def apply(self, joint: Joint, _travel: float, /) -> Joint:
        if not joint.pair:
            return joint
        tendon = joint.b if self.tendon == "b" else joint.a
        stretch = self.tension * float(tendon.chain.compliance.sum())
        winding = tendon.winding._replace(take_up=tendon.winding.take_up + stretch)
        tendon = tendon._replace(winding=winding)
        return joint._replace(b=tendon) if self.tendon == "b" else joint._replace(a=tendon)


@dataclass(frozen=True, slots=True)
class PulleyEccentricity(SideEffect):
    """Eccentric motor pulley: additional travel amplitude sin(angle + phase)."""

    type: Literal["pulley_eccentricity"] = "pulley_eccentricity"
    amplitude: float = build_ranged_field(1e-4, 0.0, 0.01, "m")  # of the additional travel
    phase: float = build_ranged_field(0.0, -math.tau, math.tau, "rad")  # at the start
    adds_up: ClassVar[bool] = False

    def change(self, tendon: Tendon, /) -> Tendon:
        winding = tendon.winding._replace(eccentricity=self.amplitude, phase=self.phase)
        return tendon._replace(winding=winding)


EndEffect = (
    Pretension
    | JointBacklash
    | JointFriction
    | AntagonistTension
    | TipInertia
    | TipMotion
    | PulleyEccentricity
)
