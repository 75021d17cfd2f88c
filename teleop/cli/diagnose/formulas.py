"""The extended law as mathematics, in the notation of matplotlib's mathtext.

Symbols are those of docs/theory.md: T tension, s friction coordinate from 0 at the housing to K at
the tip, q_p and q_d travel at the housing and at the tip, e elongation, L/EA compliance, c
compliance of the load at the tip; r what a sensor reads.
"""

from collections.abc import Sequence

from matplotlib.figure import Figure

from estimator.effects import Effect

LAW = (
    r"\left|\frac{\partial T}{\partial s}\right| \leq T, \quad"
    r" \frac{\partial T}{\partial s} = -T\,\mathrm{sgn}\,v\ \mathrm{where\ it\ slides},"
    r" \quad 0 \leq s \leq K"
)
TRAVEL = r"q_p = q_d + e, \quad e = \frac{L}{EA}\,\frac{1}{K}\int_0^K T\,\mathrm{d}s"
TIP = r"q_d = c\,T(K)"

_FRICTION = r"\frac{\partial T}{\partial s} = -\mathrm{sgn}(v)\,"
_DELAY = r"r(t) = x(t - \tau), \quad \tau = \mathrm{time}"
_FILTER = r"\mathrm{time}\,\dot r + r = x"
_STRIBECK = r"K(v) = K\left(1 + \mathrm{ratio}\;e^{-(v/\mathrm{speed})^2}\right)"

FORMULAS = {
    "friction_step": r"K(t) = K\,(1 + \mathrm{change}\cdot[\,t \geq \mathrm{onset}\,])",
    "friction_drift": r"K(t) = K\,(1 + \mathrm{rate}\;t)",
    "constant_drag": _FRICTION + r"(T + \mathrm{drag})",
    "viscous_friction": _FRICTION + r"(T + \mathrm{viscosity}\,|v|)",
    "stribeck_friction (by the motor's speed)": _STRIBECK + r", \quad v = \dot q_p",
    "stribeck_friction (by each contact's own, with a memory)": _STRIBECK
    + r", \quad \mathrm{memory}\,\dot v + v = v_{\mathrm{contact}}",
    "presliding (the same distance at any tension)": r"\mathrm{d}F = \frac{T}{\mathrm{distance}}\,"
    r"\mathrm{d}x, \quad |F| \leq T",
    "presliding (the same stiffness at any tension)": r"\mathrm{d}F ="
    r" \frac{10\,\mathrm{N}}{\mathrm{distance}}\,\mathrm{d}x, \quad |F| \leq T",
    "direction_asymmetry": r"\frac{\partial \ln T}{\partial s} = -1\ \mathrm{(pulling)}, \quad"
    r" +\mathrm{ratio}\ \mathrm{(releasing)}",
    "tension_dependent_friction (a power of the tension)": _FRICTION
    + r"T\left(\frac{T}{10\,\mathrm{N}}\right)^{\mathrm{exponent}-1}",
    "tension_dependent_friction (linear in the tension)": _FRICTION + r"T\,(1 + \mathrm{rise}\;T)",
    "stick_slip": r"K\,(1 + \mathrm{ratio}\;a), \quad \dot a ="
    r" \frac{1 - a}{\mathrm{time}} - \frac{a\,|v|}{\mathrm{distance}}",
    "nonuniform_curvature (gradually along the sheath)": r"\frac{\mathrm{d}x}{\mathrm{d}s} \propto"
    r" e^{\mathrm{ratio}\;s/K}",
    "nonuniform_curvature (two sections)": r"\frac{\mathrm{d}x}{\mathrm{d}s} \propto"
    r" e^{\mathrm{ratio}\cdot[\,s > \mathrm{cut}\;K\,]}",
    "nonlinear_stiffness": r"e \to e + \mathrm{toe}\left(1 - e^{-T/\mathrm{tension}}\right)",
    "creep": r"e \to e + \kappa, \quad \dot\kappa = \frac{\mathrm{share}\;e - \kappa}"
    r"{\mathrm{time}}",
    "sheath_compression": r"e \to e + \mathrm{compression}\,"
    r"\left(\max(T(0) - \mathrm{threshold},\,0)\right)^2",
    "slack": r"q_p \to q_p - \mathrm{length}\ \mathrm{before}\ T > 0",
    "thermal_expansion": r"e \to e + \mathrm{rate}\;\mathrm{time}\left(1 -"
    r" e^{-t/\mathrm{time}}\right)",
    "pretension (the same all along)": r"T(s, 0) = \mathrm{tension}",
    "joint_backlash": r"r = P_{\mathrm{width}/2}[q_d]\ \mathrm{(play\ operator)}",
    "joint_friction": r"T(K) = q_d/c + \mathrm{friction}\;\mathrm{sgn}\,\dot q_d",
    "antagonist_tension": r"T(K) = q_d/c + \mathrm{tension}\,(e^{\sigma} - 1), \quad"
    r" -K_2 \leq \sigma \leq K_2",
    "tip_inertia": r"T(K) = q_d/c + \mathrm{damping}\;\dot q_d + \mathrm{mass}\;\ddot q_d",
    "tip_moved (and left it there)": r"q_d = c\,T(K) + \mathrm{size}\cdot"
    r"[\,t \geq \mathrm{onset}\,]",
    "tip_moved (and took it back)": r"q_d = c\,T(K) + \mathrm{size}\cdot"
    r"[\,\mathrm{onset} \leq t < \mathrm{return}\,]",
    "proximal_tension_gain": r"r = (1 + \mathrm{gain})\,T(0)",
    "distal_tension_gain": r"r = (1 + \mathrm{gain})\,T(K)",
    "proximal_tension_bias": r"r = T(0) + \mathrm{bias}",
    "distal_tension_bias": r"r = T(K) + \mathrm{bias}",
    "proximal_tension_drift": r"r = T(0) + \mathrm{rate}\;t",
    "distal_tension_drift": r"r = T(K) + \mathrm{rate}\;t",
    "sensor_lag (the load cell at the housing, by a delay)": _DELAY + r", \quad x = T(0)",
    "sensor_lag (the load cell at the tip, by a delay)": _DELAY + r", \quad x = T(K)",
    "sensor_lag (the encoder at the motor, by a delay)": _DELAY + r", \quad x = q_p",
    "sensor_lag (the encoder at the tip, by a delay)": _DELAY + r", \quad x = q_d",
    "sensor_lag (the load cell at the housing, by a filter)": _FILTER + r", \quad x = T(0)",
    "sensor_lag (the load cell at the tip, by a filter)": _FILTER + r", \quad x = T(K)",
    "sensor_lag (the encoder at the motor, by a filter)": _FILTER + r", \quad x = q_p",
    "sensor_lag (the encoder at the tip, by a filter)": _FILTER + r", \quad x = q_d",
    "sensor_lag (all sensors at the tip, by their clock)": _DELAY + r", \quad x = T(K),\ q_d",
    "saturation (the load cell at the housing)": r"r = \min(T(0),\ \mathrm{limit})",
    "saturation (the load cell at the tip)": r"r = \min(T(K),\ \mathrm{limit})",
    "encoder_scale (the encoder at the motor)": r"r = (1 + \mathrm{gain})\,q_p",
    "encoder_scale (the encoder at the tip)": r"r = (1 + \mathrm{gain})\,q_d",
    "encoder_slip (the encoder at the motor)": r"r = q_p + \mathrm{slip}\cdot"
    r"[\,t \geq \mathrm{onset}\,]",
    "encoder_slip (the encoder at the tip)": r"r = q_d + \mathrm{slip}\cdot"
    r"[\,t \geq \mathrm{onset}\,]",
    "pulley_eccentricity": r"r = q_p + \mathrm{sine}\,\sin\frac{q_p}{\mathrm{radius}} +"
    r" \mathrm{cosine}\,\cos\frac{q_p}{\mathrm{radius}}",
    "cogging_ripple": r"r = T(0) + \mathrm{sine}\,\sin(\mathrm{number}\;q_p) +"
    r" \mathrm{cosine}\,\cos(\mathrm{number}\;q_p)",
    "sheath_rub": r"r = T(0) + \mathrm{force}\;\mathrm{sgn}\,\dot q_p\ \mathrm{(a\ play\ of"
    r"\ the\ width)}",
}
"""What each effect adds, by its label; others are given by their equation in words."""


def get_law_formulas(elastic: bool) -> tuple[str, ...]:
    """Return the plain law; without a travel in the data it is not `elastic`."""
    return (LAW, TRAVEL, TIP) if elastic else (LAW,)


def get_effect_formulas(effects: Sequence[Effect]) -> tuple[str, ...]:
    """Return what some effects add to the law."""
    return tuple(FORMULAS.get(effect.label) or _format_equation_text(effect) for effect in effects)


def draw_formula(formula: str) -> Figure:
    """Return a formula as a figure, which its bounding box is to be cut to."""
    figure = Figure(figsize=(6.0, 0.6))
    figure.set_layout_engine("none")
    figure.text(0.0, 0.4, f"${formula}$", fontsize=14)
    return figure


def _format_equation_text(effect: Effect) -> str:
    words = effect.equation
    for sign in "\\_^{}$%#&":
        words = words.replace(sign, " ")
    return r"\mathrm{" + words.replace(" ", r"\ ") + "}"
