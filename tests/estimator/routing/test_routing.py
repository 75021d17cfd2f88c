"""Routings that cannot be, and the pattern of tensions that balance."""

import numpy as np
import pytest

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
def test_the_pattern_of_pretension_balances_at_every_joint(radii):
    pattern = Routing(radii).find_pretension_pattern()
    np.testing.assert_allclose(radii.T @ pattern, 0.0, atol=1e-9)
    assert pattern.min() > 0.0
