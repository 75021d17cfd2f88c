"""Whether data and fitted numbers can be those of a tendon in a sheath, and which slip makes them.

The ranges are wide: they hold any tendon that pulls a joint through a sheath, from a nylon line to
the cable of a brake. What is outside has a wrong unit, a dead sensor or another cause.
Sources and reasons: docs/reference/data-format.md, Plausible values.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.law.sheath import Sheath
from estimator.law.transmission import build_slack_profile, build_tables, simulate_tensions
from estimator.measured_data import MeasuredData
from estimator.units import LINEAR, Units

K_RANGE = (0.005, 3.0)
"""Friction coordinate: a coefficient of 0.05 to 0.25 times bends of 0.1 to 12 rad (two turns)."""

STIFFNESS_RANGE = (100.0, 1e6)
"""EA [N]: nylon of 0.3 mm has 200 N, steel of 0.2 mm 6 kN, a steel cable of 2 mm 300 kN."""

STRAIN_MAX = 0.05
"""At the peak: steel yields at 1 %, fibres of polyethylene break at 4 %."""

RMSE_MAX = 0.10
"""Share of full scale that the RMSE of an estimate may be before data and model contradict."""

COVERAGE_MIN = 0.5
"""Share of samples that must be inside the certified interval, likewise."""

FIT_COVERAGE_MIN = 0.8
"""The same for the data that a model was fitted to."""

STRETCH_RATIO = 3.0
"""By which the stretch measured and that of the model may differ."""

SWING_MIN = 0.2
"""Share of its peak by which a tension swings that must move the other channels."""

REVERSED_CORRELATION = -0.6
"""Correlation with what pulls, below which a travel counts the other way."""

_GRID_SIZE = 16  # values of K in each of two searches
_SAMPLES_MAX = 4000  # samples of a record that tell a unit
_FACTOR_TOLERANCE = 0.25  # relative distance of a factor to that of a unit
_IMPROVEMENT_RATIO = 0.5  # of the residual, by which another unit must be better
_RESIDUAL_MAX = 0.05  # of the peak: residual of a law that describes a record


class UnitSlip(NamedTuple):
    """A unit given in place of the right one: `factor` times the value is in the right one."""

    name: str
    factor: float


FORCES = (UnitSlip("kgf", 9.80665), UnitSlip("lbf", 4.44822), UnitSlip("gram-force", 9.80665e-3))
LENGTHS = (UnitSlip("mm", 1e-3), UnitSlip("cm", 1e-2), UnitSlip("inches", 0.0254))


def find_channel_faults(data: MeasuredData, units: Units = LINEAR) -> tuple[str, ...]:
    """Return what is wrong with the channels of a record, one line each with its remedy.

    A sensor that never changes while the tension does is stuck; only a tip that is blocked stays.
    One tension of a tendon in another unit is told by `find_unit_slip`. The data are in `units`,
    NaN where a value is missing.
    """
    T_in, T_out = data.proximal_tension, data.distal_tension
    q_p, q_d = data.proximal_displacement, data.distal_displacement
    swing, peak = _compute_span(T_in), float(np.nanmax(np.abs(T_in), initial=0.0))
    out = []
    if swing == 0.0 and np.isfinite(T_in).any():  # two travels alone may be given
        out.append(
            f"proximal_tension never changes ({T_in[0]:.4g} {units.effort}): the load cell is "
            "stuck or not connected, or nothing was pulled; check it, and pull and release while "
            "you record"
        )
    moves = swing > SWING_MIN * peak and swing > 0.0
    if moves and q_p is not None and _compute_span(q_p) == 0.0 and not _is_tip_driven(T_in, q_d):
        out.append(
            f"proximal_displacement never changes ({q_p[0]:.4g} {units.travel}) while the tension "
            f"swings by {swing:.3g} {units.effort}: the encoder is stuck or not connected; check "
            "it, or remove the column"
        )
    if moves and T_out is not None and _compute_span(T_out) == 0.0:
        out.append(
            f"distal_tension never changes ({T_out[0]:.4g} {units.effort}) while the tension at "
            f"the housing swings by {swing:.3g} {units.effort}: the load cell is stuck or not "
            "connected; check it, or remove the column"
        )
    if not units.signed:
        out += _find_reversed_travel(data, units)
        if moves and T_out is not None and _compute_span(T_out) > 0.0:
            rows = np.isfinite(T_in) & np.isfinite(T_out)
            out += [slip] if (slip := find_unit_slip(T_in[rows], T_out[rows])) else []
    return tuple(out)


def _find_reversed_travel(data: MeasuredData, units: Units) -> list[str]:
    """Return which travel of a tendon counts the other way, if one does."""
    T_in, q_p, q_d = data.proximal_tension, data.proximal_displacement, data.distal_displacement
    if q_p is None:
        return []
    pulls = _compute_correlation(q_p, T_in)
    correlation = 0.0 if q_d is None else _compute_correlation(q_d, q_p)
    if correlation > 0.0 and _is_tip_driven(T_in, q_d):
        return []
    opposed = correlation < REVERSED_CORRELATION
    if pulls < (0.0 if opposed else REVERSED_CORRELATION):
        name, reference = "proximal", "tension at the housing"
    elif opposed:
        name, reference = "distal", "travel of the motor"
    else:
        return []
    return [
        f"{name}_displacement falls where the {reference} rises: it counts the other way; "
        f"{suggest_sign(f'{name}_displacement', units)}"
    ]


def suggest_sign(channel: str, units: Units) -> str:
    """Return how the sign of a channel is changed, with the option of a command that reads it."""
    effort = "torque" if units.rotary else "force" if units.signed else "tension"
    name = channel.replace("tension", effort)
    name = name.replace("displacement", "angle") if units.rotary else name
    unit = units.get_unit(channel).replace(" ", "")
    return f"change its sign, --column '{name}=COLUMN[-1 {unit}]'"


def find_implausible_parameter(K: float, EA: float | None, peak: float) -> str:
    """Return why a friction, a stiffness [N] and a peak tension [N] are no tendon's; "" if fine."""
    if not K_RANGE[0] <= K <= K_RANGE[1]:
        return (
            f"K = {K:.3g} is outside {K_RANGE[0]:g} to {K_RANGE[1]:g}, the friction of sheaths: "
            "check the units and the zeros of both tensions"
        )
    if EA is None:
        return ""
    strain = peak / EA
    if STIFFNESS_RANGE[0] <= EA and strain <= STRAIN_MAX:
        if STIFFNESS_RANGE[1] >= EA:
            return ""
        return (
            f"EA = {EA:.3g} N is stiffer than any tendon ({STIFFNESS_RANGE[1]:g} N): the "
            "travel is too small; check that it is in metres, and the length"
        )
    units = [slip.name for slip in LENGTHS if _is_plausible_stiffness(EA / slip.factor, peak)]
    units += [
        slip.name
        for slip in FORCES[:1]
        if not units and _is_plausible_stiffness(EA * slip.factor, peak)
    ]
    hint = f" (in {' or '.join(units)}?)" if units else ""
    return (
        f"EA = {EA:.3g} N stretches by {strain:.1%} at {peak:.3g} N, which no tendon does (at most "
        f"{STRAIN_MAX:.0%}): check that the travel is in metres and the tension in newtons{hint}, "
        "and that the tip does not give way"
    )


def find_unit_slip(
    proximal_tension: Array, distal_tension: Array, *, may_be_right: bool = True
) -> str:
    """Return which tension is in another unit than newtons; "" if none explains the record.

    Hysteresis tells: e^2K is between the branches, whatever the unit, and with the right factor the
    law describes both. Only the ratio of both tensions is tested, not their size. Without
    `may_be_right` the units are known to be wrong.
    """
    step = max(len(proximal_tension) // _SAMPLES_MAX, 1)
    if not len(proximal_tension):
        return ""
    T_in, T_out = proximal_tension[::step], distal_tension[::step]
    if not (T_in.max() > 0.0 and T_out.max() > 0.0):
        return ""
    plain_residual = _compute_best_residual(T_in, T_out) if may_be_right else math.inf
    if plain_residual < _RESIDUAL_MAX:
        return ""
    tried = [("distal", slip, T_in, slip.factor * T_out) for slip in FORCES]
    tried += [("proximal", slip, slip.factor * T_in, T_out) for slip in FORCES]
    candidates = [(_compute_best_residual(T_a, T_b), end, slip) for end, slip, T_a, T_b in tried]
    best = min(residual for residual, _, _ in candidates)
    if not (best < _RESIDUAL_MAX and best < _IMPROVEMENT_RATIO * plain_residual):
        return ""
    slips = [f"{e}_tension in {s.name}" for residual, e, s in candidates if residual < 1.5 * best]
    return (
        f"not in newtons, as it seems: {' or '.join(slips)}, with which the law describes the data "
        f"within {best:.1%} of the peak; convert it"
    )


def find_contradiction(rmse_share: float, inside: float, *, fitted: bool = False) -> str:
    """Return why an estimate and a measured tension contradict each other; "" if they do not.

    Parameters
    ----------
    rmse_share, inside : float
        RMSE over full scale, and the share of samples inside the certified interval.
    fitted : bool
        Whether the model was fitted to these data.
    """
    coverage_min = FIT_COVERAGE_MIN if fitted else COVERAGE_MIN
    is_inaccurate, is_uncovered = rmse_share > RMSE_MAX, inside < coverage_min
    if not (is_inaccurate or is_uncovered):
        return ""
    reasons = [f"the RMSE is {rmse_share:.0%} of full scale"] * is_inaccurate
    reasons += [f"{inside:.0%} of the samples are inside the interval"] * is_uncovered
    return " and ".join(reasons)


def find_stretch_slip(measured: Array, modelled: Array) -> str:
    """Return why the stretch measured [m] is not that of the model; "" if it may be.

    Parameters
    ----------
    measured, modelled : array, shape (n,)
        q_p - q_d, and the elongation by the model; NaN where unknown.
    """
    rows = np.isfinite(measured) & np.isfinite(modelled)
    if rows.sum() < 2 or not (_compute_span(modelled[rows]) > 0.0):
        return ""
    x, y = modelled[rows] - modelled[rows].mean(), measured[rows] - measured[rows].mean()
    ratio = float(x @ y) / float(x @ x)
    if 1.0 / STRETCH_RATIO <= ratio <= STRETCH_RATIO:
        return ""
    size = abs(ratio)
    slips = [f"the travel in {s.name}" for s in LENGTHS if _is_near(size, 1.0 / s.factor)]
    slips += [f"the tension in {s.name}" for s in FORCES if _is_near(size, s.factor)]
    slips += ["the sign of a travel"] if ratio < 0.0 and not slips and size > 0.3 else []
    hint = f"; perhaps {' or '.join(slips)}" if slips else ""
    return (
        f"the tendon stretches {ratio:.3g} times as much as the model says: check the units of "
        f"travel and tension, and the model's stiffness and length{hint}"
    )


def _is_tip_driven(tension: Array, q_d: Array | None) -> bool:
    """Return whether the tip stretches a tendon that the motor holds: it gives way as it pulls."""
    return q_d is not None and _compute_correlation(tension, q_d) < 0.0


def _compute_correlation(a: Array, b: Array) -> float:
    """Return the correlation of two signals; 0 if one of them is constant."""
    rows = np.isfinite(a) & np.isfinite(b)
    if rows.sum() < 2:
        return 0.0
    x, y = a[rows] - a[rows].mean(), b[rows] - b[rows].mean()
    size = math.sqrt(float(x @ x) * float(y @ y))
    return float(x @ y) / size if size > 0.0 else 0.0


def _is_near(value: float, factor: float) -> bool:
    return abs(math.log(value / factor)) < _FACTOR_TOLERANCE if value > 0.0 else False


def _is_plausible_stiffness(EA: float, peak: float) -> bool:
    return STIFFNESS_RANGE[0] <= EA <= STIFFNESS_RANGE[1] and peak / EA <= STRAIN_MAX


def _compute_span(signal: Array) -> float:
    """Return the range of a signal, without what is missing (NaN)."""
    finite = signal[np.isfinite(signal)]
    return float(np.ptp(finite)) if finite.size else 0.0


def _compute_best_residual(T_in: Array, T_out: Array) -> float:
    """Return the RMSE of the law at its best, over the peak; infinite if it is out of order."""
    if T_out.mean() > T_in.mean():
        return math.inf

    def cost(K: float) -> float:
        table = build_tables(Sheath.uniform(K, 1.0, 1.0))
        return float(
            np.mean((T_out - simulate_tensions(table, build_slack_profile(table), T_in)[0]) ** 2)
        )

    tried = np.geomspace(*K_RANGE, _GRID_SIZE)
    costs = [cost(K) for K in tried]
    k = int(np.argmin(costs))
    refined = np.linspace(tried[max(k - 1, 0)], tried[min(k + 1, _GRID_SIZE - 1)], _GRID_SIZE)
    return math.sqrt(min(*costs, *map(cost, refined))) / float(T_out.max())
