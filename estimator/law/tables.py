"""A sheath prepared for computation: what the law needs of the geometry, as one flat array.

The friction coordinate s = mu theta(x) orders the sheath. A curved section is an interval of s with
constant w = dx/ds = R/mu; a straight one has length but no friction, so it is a point mass of
length at one s. The tables hold, at every boundary, the running integrals
(docs/explanation/theory.md (T4))

    G^-(s) = ∫ e^-s dx,   G^+(s) = ∫ e^(rho s) dx,   x(s) = ∫ dx,

taken over [0, s] with the point mass at s included, so that a segment of a tension profile is
integrated by two look-ups, however many sections it spans.
"""

import math
from typing import TypeAlias

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.law.sheath import Sheath

Tables: TypeAlias = Array

K, LENGTH, EA, DRAG, ASYMMETRY, FIRST_LENGTH, LAST_NODE = range(7)
"""Where the scalars are; FIRST_LENGTH is the straight length at s = 0 [m]."""

_NODES = 7
_S, _X, _G_MINUS, _G_PLUS, _W, _EXP_MINUS, _EXP_PLUS = range(7)
_STRIDE = 7

MAX_SECTIONS = 64
"""Sections of a sheath that fit into the tables of a `PreparedTendon`."""

TABLES_SIZE = _NODES + _STRIDE * (MAX_SECTIONS + 1)
"""Length of the tables of so many sections, all of them curved."""

STRAIGHT_FRICTION_MAX = 1e-9
"""A section of less friction than this counts as straight: 1e-9 of relative tension."""


def build_tables(sheath: Sheath) -> Tables:
    """Return the tables of `sheath`: flat, float64, ready for the compiled functions."""
    length = np.array([section.length for section in sheath.sections])
    friction = np.array([sheath.friction * section.bend_angle for section in sheath.sections])
    tables = np.zeros(_NODES + _STRIDE * (len(length) + 1))
    tables[EA], tables[DRAG], tables[ASYMMETRY] = (
        sheath.axial_stiffness, sheath.drag, sheath.asymmetry,
    )  # fmt: skip
    fill_tables(tables, length, friction)
    return tables[: _NODES + _STRIDE * (int(tables[LAST_NODE]) + 1)]


@jit_compile
def fill_tables(tables: Tables, length: Array, friction: Array) -> None:
    """Fill in the tables of sections with this length [m] and friction mu theta, shape (n,).

    EA, drag and asymmetry stay as they are in `tables`.
    """
    rho = tables[ASYMMETRY]
    node = _NODES
    tables[node : node + _STRIDE] = 0.0
    tables[node + _EXP_MINUS] = tables[node + _EXP_PLUS] = 1.0
    for k in range(len(length)):
        ds = friction[k]
        if ds < STRAIGHT_FRICTION_MAX:
            tables[node + _X] += length[k]
            tables[node + _G_MINUS] += length[k] * tables[node + _EXP_MINUS]
            tables[node + _G_PLUS] += length[k] * tables[node + _EXP_PLUS]
            continue
        tables[node + _W] = w = length[k] / ds
        node, last = node + _STRIDE, node
        tables[node + _S] = s = tables[last + _S] + ds
        tables[node + _X] = tables[last + _X] + length[k]
        tables[node + _G_MINUS] = tables[last + _G_MINUS] - w * tables[
            last + _EXP_MINUS
        ] * math.expm1(-ds)
        tables[node + _G_PLUS] = (
            tables[last + _G_PLUS] + w * tables[last + _EXP_PLUS] * math.expm1(rho * ds) / rho
        )
        tables[node + _W] = 0.0
        tables[node + _EXP_MINUS], tables[node + _EXP_PLUS] = math.exp(-s), math.exp(rho * s)
    tables[K], tables[LENGTH] = tables[node + _S], length.sum()
    tables[FIRST_LENGTH] = tables[_NODES + _X]
    tables[LAST_NODE] = float((node - _NODES) // _STRIDE)


@jit_compile
def _find_node(tables: Tables, column: int, value: float) -> int:
    """Return the offset of the last node whose `column` does not exceed `value`."""
    low, high = 0, int(tables[LAST_NODE])
    while low < high:
        middle = (low + high + 1) // 2
        if tables[_NODES + _STRIDE * middle + column] <= value:
            low = middle
        else:
            high = middle - 1
    return _NODES + _STRIDE * low


@jit_compile
def integrate_exponential(tables: Tables, s: float, slope: float) -> float:
    """Return ∫ e^(slope s) dx over [0, s] [m], for the slopes -1, rho and 0."""
    node = _find_node(tables, _S, s)
    ds = s - tables[node + _S]
    w = tables[node + _W]
    total: float
    if slope < 0.0:
        total = tables[node + _G_MINUS] - w * tables[node + _EXP_MINUS] * math.expm1(-ds)
    elif slope > 0.0:
        part = math.expm1(slope * ds) / slope
        total = tables[node + _G_PLUS] + w * tables[node + _EXP_PLUS] * part
    else:
        total = tables[node + _X] + w * ds
    return total


@jit_compile
def compute_arc_length(tables: Tables, s: float) -> float:
    """Return x(s) [m], the far end of a straight stretch lying at `s`."""
    return integrate_exponential(tables, s, 0.0)


@jit_compile
def compute_length_density(tables: Tables, s: float) -> float:
    """Return w(s) = dx/ds = R/mu [m], point masses left out."""
    w: float = tables[_find_node(tables, _S, s) + _W]
    return w


@jit_compile
def compute_friction_coordinate(tables: Tables, x: float) -> float:
    """Return s(x) = mu theta(x) for an arc length `x` [m]; the ends bound it."""
    node = _find_node(tables, _X, x)
    ds = x - tables[node + _X]
    w = tables[node + _W]
    s: float = tables[node + _S]
    if ds > 0.0 and w > 0.0:
        s = min(s + ds / w, tables[node + _STRIDE + _S])
    return s
