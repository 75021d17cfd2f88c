"""Run-time parameters of a tendon: one number per effect, neutral by default.

The chain reads them at every step, so a fault that starts or grows is a changing knob. `effects`
changes them by name and time.
"""

from typing import NamedTuple


class Knobs(NamedTuple):
    """The deviations of one tendon from an elastic one with Coulomb friction."""

    # friction, of friction
    friction_scale: float = 1.0  # of the friction of every bend
    asymmetry: float = 1.0  # rho, friction towards the tip over friction towards the housing
    drag: float = 0.0  # tau [N] added to the tension that presses on a bend
    viscosity: float = 0.0  # [N s/m^2] friction per metre of sheath and per speed
    tension_exponent: float = 1.0  # n of friction ~ T^n
    tension_reference: float = 10.0  # [N] reference of the exponent
    stribeck_ratio: float = 0.0  # friction at rest over that at high speed, less one
    stribeck_speed: float = 1e-3  # [m/s]
    stribeck_memory: float = 0.2  # [s] time constant of the speed in the friction
    static_ratio: float = 1.0  # static over sliding friction after long rest
    static_time: float = 0.5  # [s] time constant of growth at rest
    static_distance: float = 2e-5  # [m] sliding distance of its decay
    presliding: float = 0.0  # [m] elastic deflection of a contact before it slides
    presliding_tension: float = 10.0  # [N] tension of that deflection, which is proportional to it

    # elasticity, of elasticity
    toe_strain: float = 0.0  # eps_0, strain of the toe
    toe_tension: float = 2.0  # [N] T_s of the toe
    compression: float = 0.0  # [m/N^2] of the whole sheath, above the threshold
    compression_threshold: float = 0.0  # [N]
    compression_friction: float = 0.0  # [1/N] relative rise of friction above the threshold
    creep_share: float = 0.0  # a, final creep over elastic elongation
    creep_time: float = 10.0  # [s]
    slack: float = 0.0  # [m] of excess tendon
    expansion: float = 0.0  # thermal strain of the tendon less that of the sheath


NEUTRAL = Knobs()
