"""Routings that cannot be, travels and angles, and tensions that hold an arm."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.routing.forces import distribute_torque, find_pretension
from estimator.routing.routing import Routing, RoutingError

# a finger: pairs for either joint, that of the far one passing the near one
PAIRS = np.array([[5.0, 0.0], [-5.0, 0.0], [4.0, 6.0], [-4.0, -6.0]]) * 1e-3
ONE_MORE = np.array([[5.0, 3.0], [-5.0, 3.0], [0.5, -6.0]]) * 1e-3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"radii": [[0.005, 0.0], [-0.005, 0.0]]}, "no tendon moves joint 1"),
        ({"radii": [*PAIRS.tolist(), [0.0, 0.0]]}, "no joint moves tendon 4"),
        ({"radii": [[0.005, 0.005], [-0.005, -0.005]]}, "only 1 of them"),
        ({"radii": [[0.005, 0.0], [0.0, 0.005]]}, "lacks an antagonist"),
        ({"radii": [[np.nan]]}, "finite"),
        ({"friction": [0.1, 0.1]}, "friction: shape"),
        ({"friction": 9.0, "wrap": 3.0}, "has K"),
        ({"order": [[0], [0], [0, 0], [0, 1]]}, "tendon 2"),
        ({"order": [[0], [0], [1], [0, 1]]}, "radius at joint 0"),
    ],
)
def test_an_impossible_routing_is_refused_in_one_line_that_names_it(change, words):
    with pytest.raises(RoutingError, match=words) as caught:
        Routing(**({"radii": PAIRS} | change))
    assert "\n" not in str(caught.value)


def test_a_joint_with_a_spring_needs_no_antagonist():
    routing = Routing([[0.005, 0.0], [0.0, 0.005]], spring_stiffness=0.1)
    assert (routing.find_pretension_pattern() > 0.0).all()


@pytest.mark.parametrize("radii", [PAIRS, ONE_MORE])
def test_pretension_balances_above_the_minimum_or_is_refused(radii):
    routing = Routing(radii)
    pretension = find_pretension(routing, 2.0, 40.0)
    np.testing.assert_allclose(radii.T @ pretension, 0.0, atol=1e-9)
    assert pretension.min() == pytest.approx(2.0)
    with pytest.raises(RoutingError, match="tendon"):
        find_pretension(routing, 2.0, 1.9)


@settings(deadline=None, max_examples=60)
@given(st.sampled_from([PAIRS, ONE_MORE]), st.tuples(*[st.floats(-0.4, 0.4)] * 2))
def test_distributed_tensions_make_the_torque_within_limits_and_no_more_than_needed(radii, torque):
    n = len(radii)
    least, most = np.full(n, 2.0), np.full(n, 30.0)
    pretension = find_pretension(Routing(radii), least, most)
    T, part = distribute_torque(radii, np.array(torque), pretension, least, most)
    assert (T >= 2.0 - 1e-9).all()
    assert (T <= 30.0 + 1e-9).all()
    # either all of it, or less of it in the same ratio, and then some tendon is at its limit
    np.testing.assert_allclose(radii.T @ T, part * np.array(torque), atol=1e-6)
    assert 0.0 < part <= 1.0
    assert part == 1.0 or T.max() > 29.9
    # no other tensions with this torque are lower: what changes none of it costs more
    _, _, rows = np.linalg.svd(radii.T)
    for direction in rows[np.linalg.matrix_rank(radii) :]:
        for step in (1e-3, -1e-3):
            other = T + step * direction
            if (other >= 2.0).all() and (other <= 30.0).all():
                assert np.sum((other - 2.0) ** 2) >= np.sum((T - 2.0) ** 2) - 1e-7
