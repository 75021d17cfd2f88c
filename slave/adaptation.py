"""Live adaptation of K to sheaths that move, and what is said about it.

A tendon against a spring adapts by `estimator.adaptation`, the two of a pair together by
`estimator.pair_adaptation`. Those of an arm do not: they end at several joints.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.adaptation import (
    K_MIN,
    UPDATE_S,
    Adaptation,
    AdaptedFriction,
    build_adaptation,
    observe,
)
from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.law.tables import K as _K
from estimator.online.online import TendonModel
from estimator.pair_adaptation import PairAdaptation, observe_pair
from estimator.structs import StructArray
from slave.calibration.monitor import TendonMonitor
from slave.rig_layout import EstimatedTendons, RigLayout

UNDECIDED_S = 20.0  # [s] without evidence, after which the monitor decides: see `mute_monitors`
BOUND_SHARE = 0.03  # of K: so close to its bounds, it may be beyond them
SETTLED_S = 5.0  # [s] for which K has to stay within `SETTLED_SHARE`
SETTLED_SHARE = 0.02  # of K
SETTLED_WIDTH = 0.2  # of K: the half-width that the interval of a settled K has had, at most


@dataclass(frozen=True, slots=True)
class AdaptationConfig:
    """Adaptation of K to a sheath that moves while the rig is used."""

    enabled: bool = False  # of tendons against a spring and of pairs; of arms K stays


class TendonAdapter(NamedTuple):
    """Adaptation of all tendons of a rig."""

    constants: StructArray  # AdaptationConstants, shape (tendons,)
    states: StructArray  # Adaptation, shape (tendons,); of a pair unused
    pairs: StructArray  # PairAdaptation, shape (joints,); of a single tendon unused
    places: NDArray[np.int64]  # joint and place in its pair, -1 without, shape (tendons, 2)

    def get_friction(self, tendon: int) -> Any:
        """Return the `AdaptedFriction` of a tendon, a view."""
        joint, place = self.places[tendon]
        return self.states[tendon] if place < 0 else self.pairs[joint]["ab"[place]]


def build_adapter(
    config: AdaptationConfig, joints: Sequence[Sequence[int]], models: Sequence[TendonModel]
) -> TendonAdapter | None:
    """Return the adaptation of the tendons of `Rig.joints`, None if it is off."""
    if not config.enabled:
        return None
    constants = np.concatenate([build_adaptation(model) for model in models])
    places = np.full((len(models), 2), -1)
    for k, tendons in enumerate(joints):
        places[list(tendons)] = [
            [k, place if len(tendons) == 2 else -1] for place in range(len(tendons))
        ]
    states, pairs = Adaptation.array(len(models)), PairAdaptation.array(len(joints))
    adapter = TendonAdapter(constants, states, pairs, places)
    for i in range(len(models)):  # not all in one tick
        adapter.get_friction(i)["update_age"] = i / len(models) * UPDATE_S
    return adapter


def describe_fixed(
    config: AdaptationConfig, joints: Sequence[Sequence[int]], models: Sequence[TendonModel]
) -> list[str]:
    """Return the line that names joints whose K stays as calibrated although others adapt."""
    if not config.enabled:
        return []
    adapts = [bool(build_adaptation(model)["active"][0]) for model in models]
    fixed = [str(k) for k, tendons in enumerate(joints, 1) if not all(adapts[i] for i in tendons)]
    if not fixed:
        return []
    return [
        f"slave.adaptation: K stays as calibrated at joint {', '.join(fixed)}: it is below "
        f"{K_MIN:g}, or the sheath has too many sections"
    ]


@jit_compile
def adapt_tendons(
    adapter: TendonAdapter,
    layout: RigLayout,
    prepared: StructArray,
    estimators: StructArray,
    tendons: EstimatedTendons,
    loop_tension: Array,
    dt: float,
) -> None:
    """Take a sample of all tendons after `online.advance`; change models and states in place.

    `tendons` and the tensions of their sensing loops [N], shape (MAX_TENDONS, 2), are of the
    sample, `dt` [s] is the time since the one before.
    """
    for k in range(layout.groups):
        i, j = layout.group[k].tendon[0], layout.group[k].tendon[1]
        if layout.group[k].count == 1:
            observe(
                adapter.constants[i],
                adapter.states[i],
                prepared[i],
                estimators[i],
                tendons[i].estimate,
                loop_tension[i],
                dt,
            )
        else:
            observe_pair(
                adapter.constants[i],
                adapter.constants[j],
                adapter.pairs[k],
                prepared[i],
                prepared[j],
                estimators[i],
                estimators[j],
                tendons[i].estimate,
                tendons[j].estimate,
                loop_tension[i],
                loop_tension[j],
                dt,
            )


@jit_compile
def mute_monitors(
    adapter: TendonAdapter,
    layout: RigLayout,
    prepared: StructArray,
    monitors: Sequence[TendonMonitor],
    is_degraded: bool,
    decided: NDArray[np.bool_],
) -> None:
    """Drop what the monitors found of tendons whose K the adaptation can decide; set `decided`.

    It cannot after a time without pieces that fit, or close to the bounds of K; then the monitor
    finds errors of the K in use. To end degraded mode, evidence has to have told K as well as that
    of a settled shape, however the interval in use has grown since: the posterior's holds the K in
    use and nothing far from it, and nothing speaks against it.
    """
    for k in range(layout.groups):
        group, adapts = layout.group[k], True
        for n in range(group.count):
            adapts = adapts and adapter.constants[group.tendon[n]].active
        for n in range(group.count if adapts else 0):
            i = group.tendon[n]
            low, high, doubt, age = _get_interval(adapter.states[i])
            if group.count == 2:
                pair = adapter.pairs[k]
                low, high, doubt, age = _get_interval(pair.a if n == 0 else pair.b)
            K, bounds = prepared[i].tables[_K], adapter.constants[i].K[:]
            is_inside = _is_inside(bounds, K)
            decided[i] = is_inside and age < UNDECIDED_S
            if decided[i] and is_degraded:
                width = (SETTLED_WIDTH - doubt) * K
                decided[i] = K - width <= low <= K <= high <= K + width
            if decided[i]:
                monitors[i].count, monitors[i].force_error = 0, 0.0


@jit_compile
def _get_interval(state: AdaptedFriction) -> tuple[float, float, float, float]:
    """Return the ends of the posterior's interval of K, its doubt, and the evidence's age [s]."""
    return state.low, state.high, state.doubt, state.evidence_age


@jit_compile
def _is_inside(hypotheses: Array, K: float) -> bool:
    """Return whether K is well within the bounds of the hypotheses."""
    low, high = (1.0 + BOUND_SHARE) * hypotheses.min(), (1.0 - BOUND_SHARE) * hypotheses.max()
    return bool(low < K < high)


class TendonFriction(NamedTuple):
    """K of a tendon, as its estimator has it."""

    K: float
    low: float  # ends of its interval
    high: float

    def get_width(self) -> float:
        """Return the width of the interval, which the newest evidence makes wide or narrow."""
        return self.high - self.low


def compute_friction(
    prepared: StructArray, adapter: TendonAdapter | None, tendon: int
) -> TendonFriction:
    """Return K in use of a tendon, with its interval."""
    model = prepared[tendon]
    K = float(model["tables"][_K])
    error = float(model["friction_error"] * K)
    low, high = K - error - float(model["K_below"]), K + error + float(model["K_above"])
    if adapter is not None and adapter.constants["active"][tendon]:
        bounds = adapter.constants["K"][tendon]
        low, high = max(low, bounds.min()), min(high, bounds.max())
    return TendonFriction(K, low, high)


@dataclass(slots=True)
class _Shape:
    """What is known of the shape of one sheath."""

    K: float  # as calibrated, or as it settled last
    left_s: float | None = None  # [s] when it left that
    near: float = 0.0  # K since `near_s`
    near_s: float = 0.0  # [s]
    narrowest: TendonFriction | None = None  # since `near_s`, of the narrowest interval


class ShapeChange(NamedTuple):
    """A change of shape that was found."""

    tendon: int
    begin_s: float  # when K left what it was
    before: float  # K
    now: TendonFriction
    has_settled: bool


class ShapeWatch:
    """Tells when the K of tendons leaves what it was, and when it has settled."""

    def __init__(self, prepared: StructArray, adapter: TendonAdapter) -> None:
        self._prepared, self._adapter = prepared, adapter
        self._shapes = [_Shape(float(model["tables"][_K])) for model in prepared]

    def update(self, time_s: float) -> Iterator[ShapeChange]:
        """Yield what is new at `time_s` [s]."""
        for i, shape in enumerate(self._shapes):
            state = self._adapter.get_friction(i)
            if not state["adapted"]:
                continue
            now = compute_friction(self._prepared, self._adapter, i)
            is_excluded = not state["low"] <= shape.K <= state["high"]
            if shape.left_s is None and (is_excluded or shape.near == 0.0):
                shape.left_s, shape.near, shape.near_s = time_s, now.K, time_s
                yield ShapeChange(i, time_s, shape.K, now, has_settled=False)
            if shape.left_s is None:
                continue
            if abs(now.K - shape.near) > SETTLED_SHARE * now.K:
                shape.near, shape.near_s, shape.narrowest = now.K, time_s, None
            if state["low"] <= now.K <= state["high"]:
                shape.narrowest = min(shape.narrowest or now, now, key=TendonFriction.get_width)
            settled = shape.narrowest
            if settled is not None and time_s - shape.near_s >= SETTLED_S:
                is_known = settled.get_width() <= 2.0 * SETTLED_WIDTH * settled.K
                if is_known and _is_inside(self._adapter.constants["K"][i], settled.K):
                    yield ShapeChange(i, shape.left_s, shape.K, settled, has_settled=True)
                    shape.K, shape.left_s, shape.narrowest = settled.K, None, None
