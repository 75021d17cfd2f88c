"""Effects in the sensors and in how they are read: readings differ, the tendon does not."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from estimator.array_types import Array
from estimator.effects.effect import (
    DISTAL_DISPLACEMENT,
    DISTAL_TENSION,
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Effect,
    EffectContext,
    Parameter,
    Signals,
    Values,
    compute_step,
    transform_channel,
)
from estimator.noise_treatment import apply_play
from estimator.online.reading_correction import CorrectionKind

ONSET_COUNT = 12
SLIP_STEP_COUNT = 6  # of a reading, that may be slips
TURNS_MAX = 10.0  # of the pulley in a record
BAND_COUNT = 3  # of wave numbers of a pulley that turns often, each with starts of its own
PHASE_STEP = 5.0  # [rad] over a record, that a step of the pulley's radius is at most
# [rad] that a ripple turns through in a record: a part of a wave may be anything
RIPPLE_PHASE_MIN = 5.0
SENSOR_NAMES = {
    PROXIMAL_TENSION: "the load cell at the housing",
    DISTAL_TENSION: "the load cell at the tip",
    PROXIMAL_DISPLACEMENT: "the encoder at the motor",
    DISTAL_DISPLACEMENT: "the encoder at the tip",
}

SignalTransform = Callable[[Array, Values, EffectContext], Array]


def build_sensor_effect(
    channel: str, forward: SignalTransform, inverse: SignalTransform, effect: Effect
) -> Effect:
    """Return an effect as one of a sensor: `forward` makes its reading, `inverse` takes it back."""

    def measure(signals: Signals, values: Values, context: EffectContext) -> Signals:
        if context.driver == channel:
            return signals
        return transform_channel(signals, channel, lambda signal: forward(signal, values, context))

    def invert(drive: Array, values: Values, context: EffectContext) -> Array:
        return inverse(drive, values, context) if context.driver == channel else drive

    at_housing = channel in (PROXIMAL_TENSION, PROXIMAL_DISPLACEMENT)
    return replace(
        effect,
        measure=measure,
        invert=invert,
        required_channels=effect.required_channels | {channel},
        correction=effect.correction if at_housing else None,
    )


def _build_gain(channel: str) -> Effect:
    return build_sensor_effect(
        channel,
        lambda T, values, _: (1.0 + values[0]) * T,
        lambda T, values, _: T / (1.0 + values[0]),
        Effect(
            name=f"{channel}_gain",
            cause=f"{SENSOR_NAMES[channel]} has a wrong gain",
            equation="reading = (1 + gain) T",
            parameters=(Parameter("gain", "", -0.8, 4.0, 0.02),),
            source="range assumed: 0.25 to 5 %, more after a repair",
            advice=f"Hang known weights on {SENSOR_NAMES[channel]}.",
            starts=lambda _: [(0.03,)],
            correction=CorrectionKind.TENSION_GAIN,
        ),
    )


def _build_bias(channel: str) -> Effect:
    return build_sensor_effect(
        channel,
        lambda T, values, _: T + values[0],
        lambda T, values, _: T - values[0],
        Effect(
            name=f"{channel}_bias",
            cause=f"{SENSOR_NAMES[channel]} does not read zero without tension",
            equation="reading = T + bias",
            parameters=(Parameter("bias", "N", -200.0, 200.0, 0.05),),
            source="range assumed: up to 1 % of full scale",
            advice=f"Tare {SENSOR_NAMES[channel]} while the tendon is slack.",
            starts=lambda _: [(0.1,)],
            correction=CorrectionKind.TENSION_BIAS,
        ),
    )


def _compute_ramp(values: Values, context: EffectContext) -> Array:
    return np.asarray(values[0] * (context.time - context.time[0]) / 60.0)


def _build_drift(channel: str) -> Effect:
    return build_sensor_effect(
        channel,
        lambda T, values, context: T + _compute_ramp(values, context),
        lambda T, values, context: T - _compute_ramp(values, context),
        Effect(
            name=f"{channel}_drift",
            cause=f"the zero of {SENSOR_NAMES[channel]} wanders",
            equation="reading = T + rate t",
            parameters=(Parameter("rate", "N/min", -20.0, 20.0, 0.05),),
            source="range assumed: 0.01 to 0.05 % of full scale per kelvin",
            advice=f"Let {SENSOR_NAMES[channel]} warm up, and tare it between runs.",
            starts=lambda _: [(0.2,)],
        ),
    )


def _delay_signal(signal: Array, values: Values, context: EffectContext) -> Array:
    return np.interp(context.time - values[0], context.time, signal)


def _advance_signal(signal: Array, values: Values, context: EffectContext) -> Array:
    return np.interp(context.time + values[0], context.time, signal)


def _apply_first_order_lag(signal: Array, values: Values, context: EffectContext) -> Array:
    (tau,) = values
    steps = np.diff(context.time, prepend=context.time[0])
    if tau < 1e-6:
        return signal
    decay = np.exp(-steps / tau)
    # exact for a signal that is straight between samples
    gain = 1.0 - (1.0 - decay) * tau / np.maximum(steps, 1e-12)
    out, y, previous = np.empty_like(signal), float(signal[0]), float(signal[0])
    for i, (x, k, f) in enumerate(zip(signal.tolist(), decay.tolist(), gain.tolist(), strict=True)):
        if i:
            y = y * k + x * f + previous * (1.0 - k - f)
        previous = x
        out[i] = y
    return out


def _invert_first_order_lag(signal: Array, values: Values, context: EffectContext) -> Array:
    return signal + values[0] * np.gradient(signal, context.time)


def _build_lag(
    channel: str, forward: SignalTransform, inverse: SignalTransform, equation: str, kind: str
) -> Effect:
    return build_sensor_effect(
        channel,
        forward,
        inverse,
        Effect(
            name="sensor_lag",
            cause=f"{SENSOR_NAMES[channel]} is late",
            equation=equation,
            parameters=(Parameter("time", "s", 0.0, 2.0, 0.01),),
            source="range assumed: 1 to 100 ms",
            advice="Compare the edges of one sharp pull in all channels; look at filters and time "
            "stamps.",
            starts=lambda _: [(0.03,)],
            where=f"{SENSOR_NAMES[channel]}, {kind}",
        ),
    )


def _delay_tip_signals(signals: Signals, values: Values, context: EffectContext) -> Signals:
    for channel in (DISTAL_TENSION, DISTAL_DISPLACEMENT):
        signals = transform_channel(
            signals, channel, lambda signal: _delay_signal(signal, values, context)
        )
    return signals


TIP_CLOCK = Effect(
    name="sensor_lag",
    cause="the clock of the sensors at the tip is not that of the housing",
    equation="reading(t) = signal(t - time) of all sensors at the tip",
    parameters=(Parameter("time", "s", -2.0, 2.0, 0.01),),
    source="two instruments started by hand, or not synchronised: any time",
    advice="Record both ends with one instrument, or synchronise their clocks.",
    starts=lambda _: [(-0.03,), (0.03,)],
    where="all sensors at the tip, by their clock",
    measure=_delay_tip_signals,
    required_channels=frozenset({DISTAL_TENSION}),
)


def _build_limit_starts(channel: str) -> Callable[[EffectContext], Iterable[Values]]:
    def starts(context: EffectContext) -> Iterable[Values]:
        measured = context.measured[channel][context.select_measured(channel)]
        return [(float(np.quantile(measured, 0.995)),), (0.9 * float(measured.max()),)]

    return starts


def _build_saturation(channel: str) -> Effect:
    return build_sensor_effect(
        channel,
        lambda T, values, _: np.minimum(T, values[0]),
        lambda T, _values, _context: T,
        Effect(
            name="saturation",
            cause=f"{SENSOR_NAMES[channel]} reads no more than a limit",
            equation="reading = min(T, limit)",
            parameters=(Parameter("limit", "N", 0.1, 1e4, 0.2, None),),
            source="range of the cell",
            advice="Use a cell of a wider range, or pull less.",
            starts=_build_limit_starts(channel),
            where=SENSOR_NAMES[channel],
        ),
    )


def _build_encoder_scale(channel: str) -> Effect:
    def scaled(q: Array, by: float, context: EffectContext) -> Array:
        signal = context.measured.get(channel)
        zero = 0.0 if signal is None else signal[0]  # encoders count from anywhere
        return np.asarray(zero + by * (q - zero))

    return build_sensor_effect(
        channel,
        lambda q, values, context: scaled(q, 1.0 + values[0], context),
        lambda q, values, context: scaled(q, 1.0 / (1.0 + values[0]), context),
        Effect(
            name="encoder_scale",
            cause=f"{SENSOR_NAMES[channel]} counts too much or too little, as on a pulley of "
            "another radius",
            equation="reading = (1 + gain) q",
            parameters=(Parameter("gain", "", -0.8, 4.0, 0.02),),
            source="range assumed: up to 5 %, by the wrap radius",
            advice=f"Measure a known travel with {SENSOR_NAMES[channel]}.",
            starts=lambda _: [(0.03,)],
            where=SENSOR_NAMES[channel],
            required_channels=frozenset({PROXIMAL_DISPLACEMENT}),
            correction=CorrectionKind.DISPLACEMENT_GAIN,
        ),
    )


def _compute_slip(values: Values, context: EffectContext) -> Array:
    slip, onset = values
    return slip * compute_step(context.time, onset)


def _find_slip_starts(context: EffectContext, channel: str) -> Iterable[Values]:
    """Return slips at times all over the record, and the largest steps of the reading itself.

    A step is what a reading advances by between two samples beyond the speed on both sides.
    """
    time, q = context.time, context.measured[channel]
    dt, advance = np.diff(time), np.diff(q)
    speed = advance / dt
    neighbour_speed = np.median([speed[:-4], speed[1:-3], speed[3:-1], speed[4:]], axis=0)
    step = advance[2:-2] - neighbour_speed * dt[2:-2]
    largest = np.argsort(-np.abs(step))[:SLIP_STEP_COUNT]
    measured_starts = [(float(step[k]), float(time[k + 2] + 0.5 * dt[k + 2])) for k in largest]
    return [*((5e-5, t) for t in context.spread_times(2 * ONSET_COUNT)), *measured_starts]


def _build_encoder_slip(channel: str) -> Effect:
    return build_sensor_effect(
        channel,
        lambda q, values, context: q + _compute_slip(values, context),
        lambda q, values, context: q - _compute_slip(values, context),
        Effect(
            name="encoder_slip",
            cause=f"{SENSOR_NAMES[channel]} slipped at one time",
            equation="reading = q + slip from the onset on",
            parameters=(
                Parameter("slip", "m", -0.05, 0.05, 2e-5),
                Parameter("onset", "s", 1.0, 1e6, 0.3, None, jumps=True),
            ),
            source="range assumed: 0.01 to 1 mm",
            advice="Return to a hard stop and compare; tighten the coupling of "
            f"{SENSOR_NAMES[channel]}.",
            starts=lambda context: _find_slip_starts(context, channel),
            where=SENSOR_NAMES[channel],
            required_channels=frozenset({PROXIMAL_DISPLACEMENT}),
        ),
    )


def find_waves(
    phase: Array, residual: Array, gain: Array, regressors: Array, wave_numbers: Array
) -> list[Values]:
    """Return (sine, cosine, wave number) of the waves in a residual that explain most of it.

    Parameters
    ----------
    phase : ndarray
        Travel [m], shape (n,).
    residual, gain : ndarray
        What is to be explained, and by how much a wave of travel or force shows in it, (n,).
    regressors : ndarray
        What else may be in the residual, shape (n, m).
    wave_numbers : ndarray
        Wave numbers to try [rad/m].
    """
    basis, _ = np.linalg.qr(regressors)
    remainder = residual - basis @ (basis.T @ residual)
    candidates = []
    for number in wave_numbers.tolist():
        pair = np.column_stack([np.sin(number * phase), np.cos(number * phase)]) * gain[:, None]
        pair -= basis @ (basis.T @ pair)
        amplitude, *_ = np.linalg.lstsq(pair, remainder, rcond=None)
        residue = remainder - pair @ amplitude
        candidates.append(
            (float(residue @ residue), float(amplitude[0]), float(amplitude[1]), number)
        )
    best = sorted(candidates)[:12]
    chosen: list[Values] = []
    for _, sine, cosine, number in best:
        if all(abs(number / other[2] - 1.0) > 0.1 for other in chosen):
            chosen.append((sine, cosine, number))
    return chosen[:3]


def _build_regressors(context: EffectContext) -> tuple[Array, Array, Array]:
    """Return travel, residual of T_in, and what the model's own parameters could do to it.

    Of the samples in which T_in was measured.
    """
    rows = context.select_measured(PROXIMAL_TENSION)
    residual = context.measured[PROXIMAL_TENSION] - context.simulated[PROXIMAL_TENSION]
    T = context.simulated[PROXIMAL_TENSION]
    taut = 0.02 * context.peak < T
    stiffness = np.where(taut, 1.0 / np.maximum(context.compliance, 1e-6), 0.0)
    regressors = np.column_stack([stiffness, stiffness * (context.drive - context.drive[0]), T])
    return context.drive[rows], residual[rows], regressors[rows]


def rotate_wave(values: Values, zero: float) -> Values:
    """Return a wave's values for an encoder that reads `zero` more: sine, cosine and radius."""
    sine, cosine, radius = values
    phase = zero / radius
    c, s = float(np.cos(phase)), float(np.sin(phase))
    return sine * c + cosine * s, cosine * c - sine * s, radius


def _find_eccentricity_starts(context: EffectContext) -> Iterable[Values]:
    q, residual, regressors = _build_regressors(context)
    low = 1.0 / np.geomspace(5e-2, 2e-3, 24)
    span = max(float(np.ptp(q)), 1e-6)
    high = np.arange(low[-1], TURNS_MAX * 2.0 * np.pi / span, 0.6 / span)[1:]
    return [  # each band of its own: a wave that is large is in the residual with its harmonics
        (-sine, -cosine, 1.0 / number)
        for band in (low, *np.array_split(high, BAND_COUNT))
        for sine, cosine, number in find_waves(q, residual, regressors[:, 0], regressors, band)
    ]


def _limit_radius(
    parameters: tuple[Parameter, ...], span: float, values: Values
) -> tuple[Parameter, ...]:
    *amplitudes, radius = parameters
    radius_min = min(span / (TURNS_MAX * 2.0 * np.pi), 0.5 * radius.high)
    radius_now = max(values[2], radius_min)
    # at the end of the record, a part of a turn
    step = min(radius.step, PHASE_STEP * radius_now**2 / max(span, 1e-6))
    return (*amplitudes, radius._replace(low=max(radius.low, radius_min), step=step))


def _remove_eccentricity(travel: Array, values: Values, _context: EffectContext) -> Array:
    sine, cosine, radius = values
    phase = travel / radius
    wave = sine * np.sin(phase) + cosine * np.cos(phase)
    return np.asarray(travel - wave + wave[0])


PULLEY_ECCENTRICITY = Effect(
    name="pulley_eccentricity",
    cause="the pulley at the motor runs out of true",
    equation="reading = q + sine sin(q/radius) + cosine cos(q/radius)",
    parameters=(
        Parameter("sine", "m", -2e-3, 2e-3, 1e-5),
        Parameter("cosine", "m", -2e-3, 2e-3, 1e-5),
        Parameter("radius", "m", 1e-5, 0.2, 1e-3, None),
    ),
    source="range assumed: 10 to 200 um",
    advice="Turn the pulley twice or more in a record, then true it or keep the table.",
    starts=_find_eccentricity_starts,
    invert=_remove_eccentricity,
    required_channels=frozenset({PROXIMAL_DISPLACEMENT}),
    limit_parameters=_limit_radius,
    correction=CorrectionKind.PULLEY_ECCENTRICITY,
    shift_encoder_zero=rotate_wave,
)


def _find_ripple_starts(context: EffectContext) -> Iterable[Values]:
    q, residual, others = _build_regressors(context)
    span = max(float(np.ptp(q)), 1e-6)
    numbers = np.arange(RIPPLE_PHASE_MIN / span, min(2e4, 1500.0 / span), 0.6 / span)
    step = max(1, len(q) // 3000)
    return find_waves(q[::step], residual[::step], np.ones(len(q))[::step], others[::step], numbers)


def _limit_wave_number(
    parameters: tuple[Parameter, ...], span: float, _values: Values
) -> tuple[Parameter, ...]:
    *amplitudes, number = parameters
    low = min(RIPPLE_PHASE_MIN / max(span, 1e-6), 0.5 * number.high)
    return (*amplitudes, number._replace(low=low))


def _apply_ripple(signals: Signals, values: Values, context: EffectContext) -> Signals:
    sine, cosine, number = values
    phase = number * context.drive
    wave = sine * np.sin(phase) + cosine * np.cos(phase)
    return transform_channel(signals, PROXIMAL_TENSION, lambda T: T + wave)


COGGING_RIPPLE = Effect(
    name="cogging_ripple",
    cause="the motor's or the gear's ripple is in the tension at the housing",
    equation="reading = T + sine sin(number q) + cosine cos(number q)",
    parameters=(
        Parameter("sine", "N", -20.0, 20.0, 0.03),
        Parameter("cosine", "N", -20.0, 20.0, 0.03),
        Parameter("number", "rad/m", 10.0, 1e5, 5.0, None),
    ),
    source="range assumed: 0.5 to 3 % of the stall torque",
    advice="Nothing at the tip; a table over the motor's angle takes it out of the reading.",
    starts=_find_ripple_starts,
    measure=_apply_ripple,
    required_channels=frozenset({PROXIMAL_DISPLACEMENT}),
    limit_parameters=_limit_wave_number,
    correction=CorrectionKind.TENSION_RIPPLE,
    shift_encoder_zero=lambda values, zero: (
        *rotate_wave((*values[:2], 1.0 / values[2]), zero)[:2],
        values[2],
    ),
)


def _apply_sheath_rub(signals: Signals, values: Values, context: EffectContext) -> Signals:
    force, width = values
    lead = (context.drive - apply_play(context.drive, 0.5 * width)) / (0.5 * width)
    return transform_channel(signals, PROXIMAL_TENSION, lambda T: T + force * lead)


SHEATH_RUB = Effect(
    name="sheath_rub",
    cause="the sheath rubs in its over-tube in front of the load cell at the housing",
    equation="reading = T + force sgn(dq/dt), the turn taken over the width",
    parameters=(
        Parameter("force", "N", -100.0, 100.0, 0.05),
        Parameter("width", "m", 2e-6, 2e-2, 1e-4, None),
    ),
    source="the paper's cell sits under the sheath; range assumed",
    advice="Measure the tendon's own tension, or fix the sheath behind the cell.",
    starts=lambda _: [(0.15, width) for width in (1e-5, 1e-4, 6e-4)],
    measure=_apply_sheath_rub,
    required_channels=frozenset({PROXIMAL_DISPLACEMENT}),
    correction=CorrectionKind.SHEATH_RUB,
)

_TENSIONS = (PROXIMAL_TENSION, DISTAL_TENSION)
_TRAVELS = (PROXIMAL_DISPLACEMENT, DISTAL_DISPLACEMENT)
_LAGS = (
    (_delay_signal, _advance_signal, "reading(t) = signal(t - time)", "by a delay"),
    (_apply_first_order_lag, _invert_first_order_lag, "time dr/dt + r = signal", "by a filter"),
)

EFFECTS = (
    *(_build_gain(channel) for channel in _TENSIONS),
    *(_build_bias(channel) for channel in _TENSIONS),
    *(_build_drift(channel) for channel in _TENSIONS),
    *(_build_lag(channel, *kind) for kind in _LAGS for channel in (*_TENSIONS, *_TRAVELS)),
    TIP_CLOCK,
    *(_build_saturation(channel) for channel in _TENSIONS),
    *(_build_encoder_scale(channel) for channel in _TRAVELS),
    *(_build_encoder_slip(channel) for channel in _TRAVELS),
    PULLEY_ECCENTRICITY,
    COGGING_RIPPLE,
    SHEATH_RUB,
)
