"""How the compliance of a sheath is spread over friction: the pattern, and its best fit to a loop.

Over the friction depth s the tension T(s, t) is a play operator of T_in (docs/explanation/theory.md
(T10)), whatever the sheath. So, with dC the compliance between s and s + ds,

    q_p = q_0 + ∫ T(s, t) dC(s),   s from 0 to K,

is linear in the compliance. A stretch of constant bend radius has its compliance spread evenly over
an interval of s, a straight one has it all at one depth. A `Shape` says where intervals end and
which of their ends carry a straight stretch; the compliances, none of them negative, follow
from least squares, and only the ends of the intervals, of which the last is K, are searched.

Behind the sheath, in an arm, the tendon goes on in stretches between guides. These are known but
for EA, which is that of the sheath: so each compliance of the sheath brings its share of theirs.
The stops at which joints are held yield a little: one compliance more, unknown but small. What the
friction of guides differs from the known one is unknown and small, too.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array, Mask
from estimator.calibration.blocked_loop import BlockedLoop
from estimator.fitting import compute_central_differences, minimise_squares
from estimator.law.sheath import Section, Sheath

K_MAX = 3.0
"""Friction coordinate up to which a loop is searched."""

STEP_MIN = 0.004
"""Shortest interval of s that is searched."""

_NODE_SPACING = 0.01  # of s
_TENSION_MIN = 1e-9  # [N]
_SLACK = math.log(_TENSION_MIN) - K_MAX
_YIELD_SHARE = 0.05  # of the slope of all of the loop: one sigma of what a stop yields
_DEEPER = 1.1  # times the depths of a tail, to see what its friction changes
_TAIL_ERROR_MIN = 1e-3
_RELATIVE_STEP = 1e-3  # relative, of the intervals
_TURN_STEP = 2e-4  # relative, of the turning tensions
_ZERO_STEP = 1e-4  # [N]
_DEGENERATE = 1e-8  # of the largest singular value: differences of these steps tell no less
# how far refining goes: ln, ln, uncertainties
_ENDS_RANGE, _TURNS_RANGE, _ZERO_RANGE = 0.7, 0.5, 3.0


class Tail(NamedTuple):
    """The stretches of a tendon between guides behind its sheath."""

    share: tuple[float, ...] = ()  # length of each over that of the sheath
    depth: tuple[float, ...] = ()  # friction from the sheath's end to each
    # by how much the tip moves there where each stop yields by 1 m/N
    yields: tuple[float, ...] = ()
    error: float = 0.0  # relative standard uncertainty of the depths


NO_TAIL = Tail()
NO_PRIOR = np.empty(0)


@dataclass(frozen=True, slots=True)
class Pattern:
    """Compliance over friction depth, n intervals from the motor to the tip."""

    ends: tuple[float, ...]  # s at the end of each interval, rising; the last is K
    spread: tuple[float, ...]  # compliance of each interval [m/N]
    straight: tuple[float, ...]  # the same of a straight stretch at s = 0 and at each end [m/N]
    stop: float = 0.0  # compliance of stops behind the sheath [m/N], not of it

    @property
    def K(self) -> float:  # noqa: N802 (the paper's symbol)
        """Friction coordinate of the tip."""
        return self.ends[-1]

    @property
    def compliance(self) -> float:
        """L/EA [m/N]."""
        return math.fsum((*self.spread, *self.straight))

    def compute_slope(self, sign: float, tail: Tail = NO_TAIL) -> float:
        """Return ∫ e^(sign s) dC [m/N]: M_pull for -1, M_rel for +1 (T4)."""
        begin = (0.0, *self.ends)
        total = math.fsum(c * math.exp(sign * s) for c, s in zip(self.straight, begin, strict=True))
        for a, b, c in zip(begin[:-1], begin[1:], self.spread, strict=True):
            total += c * math.exp(sign * a) * math.expm1(sign * (b - a)) / (sign * (b - a))
        return total + self.compute_tail_slope(sign, tail)

    def compute_tail_slope(self, sign: float, tail: Tail) -> float:
        """Return the part of a slope [m/N] that is of what follows the sheath."""
        at = zip(tail.share, tail.yields, tail.depth, strict=True)
        return math.fsum(
            (self.compliance * r + self.stop * y) * math.exp(sign * (self.K + s)) for r, y, s in at
        )

    def adjust_friction(self, K: float) -> "Pattern":
        """Return the pattern with more or less friction in its last bend, or else in all of them.

        Its compliances stay: the loop has shown them, and hardly how far the last bend goes.
        """
        before = self.ends[-2] if len(self.ends) > 1 else 0.0
        if before + STEP_MIN < K:
            return replace(self, ends=(*self.ends[:-1], K))
        return replace(self, ends=tuple(end * K / self.K for end in self.ends))

    def build_sheath(self, length: float, friction: float = 0.1) -> Sheath:
        """Return a sheath of that pattern, `length` [m] long, motor first.

        Neither EA nor mu shows at the housing, only L/EA and mu times angle: EA follows from
        `length`, bend radii from `friction`, and T_out and elongation depend on neither.
        """
        per_metre = self.compliance / length
        sections = []
        begin = 0.0
        for end, spread, straight in zip(
            (0.0, *self.ends), (0.0, *self.spread), self.straight, strict=True
        ):
            if end > begin:
                # A bend needs some length; what has no compliance gets next to none.
                metres = max(spread / per_metre, 1e-6 * length)
                sections.append(Section(metres, friction * metres / (end - begin)))
            if straight > 0.0:
                sections.append(Section(straight / per_metre))
            begin = end
        total = math.fsum(section.length for section in sections)
        return Sheath(tuple(sections), friction, total / self.compliance)


class Shape(NamedTuple):
    """Which pattern parameters exist, and which are searched."""

    ends: Array  # s, rising, shape (n,)
    straight: Mask  # at s = 0 and at each end, shape (n + 1,)

    @property
    def parameters(self) -> int:
        """Number of ends and compliances."""
        return 2 * len(self.ends) + int(self.straight.sum())


class PatternFit(NamedTuple):
    """A shape, its best pattern, and how far the loop is from it."""

    shape: Shape
    pattern: Pattern
    chi2: float  # squared residuals in units of the noise


class Uncertainty(NamedTuple):
    """Standard uncertainties that sensor noise leaves a fit of a given shape."""

    K: float
    compliance: float  # [m/N]
    zero: float  # [N]


class PlayOperators:
    """T(s, t) of a loop on nodes of s, and its integrals, for given turning tensions."""

    def __init__(self, loop: BlockedLoop, turns: Array, zero: float, tail: Tail) -> None:
        """Drive the play operators through the loop.

        `turns` [N] are the tensions between branches, `zero` [N] is the reading without tension.
        """
        self._loop, self._tail = loop, tail
        deepest = K_MAX + max(tail.depth, default=0.0) * _DEEPER
        self._s = np.arange(0.0, deepest + 1.5 * _NODE_SPACING, _NODE_SPACING)[:, None]
        y = np.full_like(self._s, _SLACK)
        lines, logs = [], []
        for number, branch in enumerate(loop.branches):
            u = np.log(np.maximum(branch.T - zero, _TENSION_MIN))
            line = u - self._s if branch.pull else u + self._s
            lines.append(line)
            logs.append(np.maximum(y, line) if branch.pull else np.minimum(y, line))
            if number < len(turns):
                u_turn = math.log(float(turns[number]))
                y = np.minimum(np.maximum(y, u_turn - self._s), u_turn + self._s)
        ln_T = np.hstack(logs)
        self._sliding = np.hstack(lines) == ln_T
        self._T = np.exp(ln_T)
        # Between nodes ln T is straight, and the logarithmic mean is the mean tension.
        rise = np.diff(ln_T, axis=0)
        rise[np.abs(rise) < 1e-9] = 1e-9
        self._integral = np.zeros_like(self._T)
        np.cumsum(np.diff(self._T, axis=0) / rise * _NODE_SPACING, axis=0, out=self._integral[1:])

    def compute_columns(self, shape: Shape) -> Array:
        """Return travel per compliance [N] of intervals, then of straight stretches.

        With a tail also of stops, and of guides' friction that is larger or smaller.
        """
        begin = np.concatenate([[0.0], shape.ends])
        k, f, T_a, T_b = self._find_nodes(begin)
        # Cubic in between: the derivative of the integral is T.
        total = (
            self._integral[k] * (1 - f) ** 2 * (1 + 2 * f)
            + self._integral[k + 1] * f**2 * (3 - 2 * f)
            + _NODE_SPACING * f * (1 - f) * (T_a * (1 - f) - T_b * f)
        )
        spread = np.diff(total, axis=0) / np.diff(begin)[:, None]
        at = T_a * (1 - f) + T_b * f
        columns = np.vstack([spread, at[shape.straight]])
        if self._tail.share:
            depth = np.array(self._tail.depth)
            _, f, T_a, T_b = self._find_nodes(begin[-1] + np.append(depth, depth * _DEEPER))
            behind, deeper = np.split(T_a * (1 - f) + T_b * f, 2)
            share = np.array(self._tail.share)
            change = share @ (deeper - behind) / (_DEEPER - 1.0)
            columns += share @ behind
            columns = np.vstack([columns, np.array(self._tail.yields) @ behind, change, -change])
        return np.asarray(columns.T)

    def _find_nodes(self, s: Array) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """Return the nodes before each `s`, the part of the way to the next, and T at both."""
        position = np.clip(s / _NODE_SPACING, 0.0, len(self._s) - 1.001)
        k = position.astype(np.int64)
        return k, (position - k)[:, None], self._T[k], self._T[k + 1]

    def compute_slopes(self, pattern: Pattern) -> Array:
        """Return de/dT_in of each average [m/N] (T7)."""
        signs = np.concatenate(
            [np.full(len(b.T), -1.0 if b.pull else 1.0) for b in self._loop.branches]
        )
        gain = np.where(self._sliding, np.exp(signs * self._s), 0.0)
        running = np.zeros_like(gain)
        np.cumsum(0.5 * _NODE_SPACING * (gain[1:] + gain[:-1]), axis=0, out=running[1:])
        begin = np.array([0.0, *pattern.ends])
        k = np.rint(begin / _NODE_SPACING).astype(np.int64)
        density = np.array(pattern.spread) / np.diff(begin)
        slopes = density @ np.diff(running[k], axis=0) + np.array(pattern.straight) @ gain[k]
        if self._tail.share:
            k = np.rint((pattern.K + np.array(self._tail.depth)) / _NODE_SPACING).astype(np.int64)
            slopes += pattern.compliance * np.array(self._tail.share) @ gain[k]
        return np.asarray(slopes)

    def compute_free_columns(self, step: float) -> Array:
        """Return travel per compliance [N] of straight stretches every `step` of s."""
        return np.asarray(self._T[:: round(step / _NODE_SPACING)].T)


class PatternLeastSquares:
    """Least squares of patterns to one loop, every average weighted by its noise."""

    def __init__(self, loop: BlockedLoop, zero_uncertainty: float, tail: Tail = NO_TAIL) -> None:
        """Weigh by the mean slope until `weigh` knows a pattern.

        `zero_uncertainty` [N] is how well the load cell has been zeroed.
        """
        self._loop, self._tail = loop, tail
        self._zero_uncertainty = max(zero_uncertainty, 1e-9)
        self._turns = np.maximum(loop.turns[:-1], _TENSION_MIN)
        self.zero = 0.0
        self._q = np.concatenate([branch.q for branch in loop.branches])
        self._count = np.concatenate([branch.count for branch in loop.branches])
        self._readings = np.concatenate([branch.readings for branch in loop.branches])
        T = np.concatenate([branch.T for branch in loop.branches])
        self._play = PlayOperators(loop, self._turns, self.zero, tail)
        slope = float(np.ptp(self._q) / np.ptp(T))
        error = max(tail.error, _TAIL_ERROR_MIN)
        sigmas = slope * np.array([_YIELD_SHARE, error, error] if tail.share else [])
        self._prior_weights = 1.0 / sigmas
        self._set_weights(np.full_like(self._q, slope))

    @property
    def n(self) -> int:
        """Number of averages."""
        return len(self._q)

    @property
    def state(self) -> tuple[Array, float]:
        """The turning tensions [N] and the zero [N] in use."""
        return self._turns, self.zero

    @state.setter
    def state(self, state: tuple[Array, float]) -> None:
        self._turns, self.zero = state
        self._play = PlayOperators(self._loop, self._turns, self.zero, self._tail)

    def weigh(self, pattern: Pattern) -> None:
        """Weigh by the slopes of `pattern`, which make tension noise a residual of travel."""
        self._set_weights(self._play.compute_slopes(pattern))

    def compute_free_chi2(self, step: float) -> float:
        """Return chi² of the best pattern of any shape: what no shape can do better than."""
        residual, _ = self._solve(self._play.compute_free_columns(step))
        return float(residual @ residual)

    def fit(self, shape: Shape, evaluations: int = 25, *, hold_last: bool = False) -> PatternFit:
        """Return the best fit of a shape, its ends moved; `hold_last` keeps the last width."""
        logs = _to_logs(shape.ends)
        fixed_logs = logs[-1:] if hold_last else logs[:0]
        free = logs[: len(logs) - len(fixed_logs)]

        def ends(x: Array) -> Array:
            return _from_logs(np.concatenate([x, fixed_logs]))

        def residual(x: Array) -> Array:
            return self._solve_shape(shape._replace(ends=ends(x)))[0]

        solution = minimise_squares(
            residual,
            free,
            math.log(STEP_MIN) - 1e-6,
            math.log(K_MAX),
            diff_step=_RELATIVE_STEP,
            x_scale=1.0,
            xtol=1e-4,
            ftol=1e-5,
            max_nfev=evaluations,
        )
        return self._fit_shape(shape._replace(ends=ends(solution.values)))

    def refine(self, fit: PatternFit) -> tuple[PatternFit, Uncertainty]:
        """Move the turning tensions and the zero too; return the fit and what noise leaves open."""
        n = len(fit.shape.ends)

        def solve(x: Array) -> tuple[Array, Array]:
            turns, zero = np.exp(x[n:-1]), float(x[-1])
            self._play = PlayOperators(self._loop, turns, zero, self._tail)
            return self._solve_shape(fit.shape._replace(ends=_from_logs(x[:n])))

        def residual(x: Array) -> Array:
            return np.append(solve(x)[0], x[-1] / self._zero_uncertainty)

        start = np.concatenate([_to_logs(fit.shape.ends), np.log(self._turns), [self.zero]])
        steps = np.repeat([_RELATIVE_STEP, _TURN_STEP, _ZERO_STEP], [n, len(self._turns), 1])
        room = np.repeat(
            [_ENDS_RANGE, _TURNS_RANGE, _ZERO_RANGE * self._zero_uncertainty],
            [n, len(self._turns), 1],
        )
        solution = minimise_squares(
            residual,
            start,
            start - room,
            start + room,
            jac=lambda x: compute_central_differences(residual, x, steps),
            x_scale="jac",
            max_nfev=10,
        )
        best = solution.values
        inverse = np.linalg.pinv(solution.jacobian, _DEGENERATE)
        K_by = np.zeros(len(best))
        K_by[:n] = np.exp(best[:n])  # K is the sum of the intervals
        count = n + int(fit.shape.straight.sum())
        C_by = compute_central_differences(
            lambda x: solve(x)[1][:count].sum(keepdims=True), best, steps
        )[0]
        self.state = np.exp(best[n:-1]), float(best[-1])
        refined = self._fit_shape(fit.shape._replace(ends=_from_logs(best[:n])))
        linear = self._compute_linear_uncertainty(refined)
        return refined, Uncertainty(
            float(np.linalg.norm(K_by @ inverse)),
            math.hypot(float(np.linalg.norm(C_by @ inverse)), linear),
            float(np.linalg.norm(inverse[-1])),
        )

    def compute_tension_residual(self, fit: PatternFit) -> float:
        """Return the root mean square of the residuals as a tension [N], noise left in."""
        residual, _ = self._solve_shape(fit.shape)
        scaled = residual[: self.n] / np.sqrt(self._count)  # in units of the noise of one sample
        return self._loop.sigma * float(np.sqrt(np.average(scaled**2, weights=self._count)))

    def _compute_linear_uncertainty(self, fit: PatternFit) -> float:
        """Return that of the sum of compliances while the ends stay [m/N]."""
        used = np.array([*fit.pattern.spread, *np.array(fit.pattern.straight)[fit.shape.straight]])
        A = self._remove_offset(self._play.compute_columns(fit.shape) * self._weight[:, None])
        A = A[:, : len(used)][:, used > 0.0]
        scale = np.linalg.norm(A, axis=0)
        return float(np.linalg.norm((1.0 / scale) @ np.linalg.pinv(A / scale, _DEGENERATE)))

    def _set_weights(self, slope: Array) -> None:
        self._weight = 1.0 / np.hypot(
            slope * self._loop.sigma / np.sqrt(self._count),
            self._loop.step / np.sqrt(self._readings),
        )
        self._mean = self._weight / np.linalg.norm(self._weight)
        self._target = self._remove_offset(self._q * self._weight)

    def _remove_offset(self, weighted: Array) -> Array:
        """Return weighted columns without what the offset q_0 takes up."""
        mean = self._mean if weighted.ndim == 1 else self._mean[:, None]
        return np.asarray(weighted - mean * (self._mean @ weighted))

    def _solve_shape(self, shape: Shape) -> tuple[Array, Array]:
        return self._solve(self._play.compute_columns(shape), self._prior_weights)

    def _solve(self, columns: Array, prior_weights: Array = NO_PRIOR) -> tuple[Array, Array]:
        """Return residuals and compliances [m/N]; a prior makes the last ones small."""
        A, target = self._remove_offset(columns * self._weight[:, None]), self._target
        count = len(prior_weights)
        prior = np.hstack([np.zeros((count, A.shape[1] - count)), np.diag(prior_weights)])
        A, target = np.vstack([A, prior]), np.append(target, np.zeros(count))
        scale = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
        from scipy.optimize import nnls

        x, _ = nnls(A / scale, target, maxiter=50 * A.shape[1])
        return target - (A / scale) @ x, x / scale

    def _fit_shape(self, shape: Shape) -> PatternFit:
        residual, x = self._solve_shape(shape)
        n, count = len(shape.ends), int(shape.straight.sum())
        straight = np.zeros(n + 1)
        straight[shape.straight] = x[n : n + count]
        stop = float(x[n + count]) if len(x) > n + count else 0.0
        pattern = Pattern(
            tuple(shape.ends.tolist()), tuple(x[:n].tolist()), tuple(straight.tolist()), stop
        )
        return PatternFit(shape, pattern, float(residual @ residual))


def _to_logs(ends: Array) -> Array:
    return np.log(np.maximum(np.diff(ends, prepend=0.0), STEP_MIN))


def _from_logs(logs: Array) -> Array:
    ends = np.cumsum(np.exp(logs))
    return np.asarray(ends * min(1.0, K_MAX / float(ends[-1])))
