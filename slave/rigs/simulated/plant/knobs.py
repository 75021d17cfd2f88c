"""What can be changed about a tendon while it runs: one number for each effect, neutral by default.

The chain obeys whatever the knobs say at a step, so a fault that starts or grows is a knob that
turns. `effects` turns them by name and time.
"""

from typing import NamedTuple


class Knobs(NamedTuple):
    """The deviations of one tendon from an elastic one with Coulomb friction."""

    # friction, of friction
    friction_scale: float = 1.0  # of the friction of every bend
    asymmetry: float = 1.0  # rho, friction of a move towards the tip over one to the housing
    drag: float = 0.0  # tau [N] by which the tension that presses on a bend seems higher
    viscosity: float = 0.0  # [N s/m^2] friction per metre of sheath and per speed
    tension_exponent: float = 1.0  # n of friction ~ T^n
    tension_reference: float = 10.0  # [N] where the exponent changes nothing
    stribeck_ratio: float = 0.0  # friction at rest over that of fast sliding, less one
    stribeck_speed: float = 1e-3  # [m/s]
    stribeck_memory: float = 0.2  # [s] that friction needs to follow the speed
    static_ratio: float = 1.0  # friction of a contact that rested long over that of one that slid
    static_time: float = 0.5  # [s] of rest that a contact needs to grow
    static_distance: float = 2e-5  # [m] of sliding that renews it
    presliding: float = 0.0  # [m] that a contact gives elastically before it slides
    presliding_tension: float = 10.0  # [N] at which it gives that much; it gives in proportion

    # elasticity, of elasticity
    toe_strain: float = 0.0  # eps_0, by which the strands bed in
    toe_tension: float = 2.0  # [N] T_s that it takes
    compression: float = 0.0  # [m/N^2] of the whole sheath, above the threshold
    compression_threshold: float = 0.0  # [N]
    compression_friction: float = 0.0  # [1/N] by which friction rises above the threshold
    creep_share: float = 0.0  # a, final creep over elastic elongation
    creep_time: float = 10.0  # [s]
    slack: float = 0.0  # [m] of tendon too much
    expansion: float = 0.0  # thermal strain of the tendon over that of the sheath


NEUTRAL = Knobs()
