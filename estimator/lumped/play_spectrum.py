"""Plays in parallel: a force that reaches the tip over contacts that let go one after another.

By (T10) the tension at friction coordinate s is a play of threshold s on ln T_in. A tendon whose
strands, or whose contacts, do not all let go at K is taken as strands side by side that share the
force: strand j bears on the sheath with K_j and carries the share w_j. Then

    T_out = sum_j w_j T(K_j),    e = integral of T(s) sum_j w_j c(s/K_j)/K_j ds,

with c the compliance along one strand: one chain that is as deep as the largest K_j, read out at
several depths. This is a Prandtl-Ishlinskii model (Kuhnen, Eur. J. Control 9, 2003), or Iwan's of
elements in parallel (J. Appl. Mech. 33, 1966), with thresholds in proportion to the tension.
"""

from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.lumped.nodes import EDGES, NODES, PLACES

ONE_PLAY = np.array([[1.0, 1.0]])
"""The plain law: all of the force over K."""

_SHARE_MIN = 1e-6  # share of the compliance of any node: the deepest may have next to no strand


class PlayNodes(NamedTuple):
    """A spectrum of plays on nodes."""

    depth: float  # largest threshold over K
    tip_shares: Array  # of the force at the tip, of each node, (NODES,)
    weights: Array  # share of the compliance at each node, (NODES,)


def build_spectrum(thresholds: Array, weights: Array) -> Array:
    """Return plays as `Physics.spectrum` has them: thresholds over K, and shares that add to 1."""
    return np.column_stack([thresholds, weights / np.sum(weights)])


def distribute_spectrum(spectrum: Array, weights: Array) -> PlayNodes:
    """Return a spectrum of plays on nodes, with the `weights` of one strand along its depth."""
    if len(spectrum) == 1 and spectrum[0, 0] == 1.0:
        return PlayNodes(1.0, np.eye(NODES)[-1], weights)
    thresholds, parts = spectrum.T
    depth = float(thresholds.max())
    places = thresholds / depth
    index = np.minimum(np.searchsorted(PLACES, places, side="right") - 1, NODES - 2)
    fraction = (places - PLACES[index]) / (PLACES[index + 1] - PLACES[index])
    shares = np.bincount(index, parts * (1.0 - fraction), NODES)
    shares += np.bincount(index + 1, parts * fraction, NODES)
    cumulative = np.concatenate([[0.0], np.cumsum(weights)])
    strands = np.minimum(EDGES[1:, None] / np.maximum(places, 1e-12), 1.0)
    total = np.concatenate([[0.0], np.interp(strands, EDGES, cumulative) @ parts])
    node_weights = np.maximum(np.diff(total), _SHARE_MIN)
    return PlayNodes(
        depth, np.asarray(shares, np.float64), np.asarray(node_weights / node_weights.sum())
    )
