"""The local model of what a tip meets: it learns a slope, and only ever resists."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.coupling import contact
from teleop.coupling.contact import Contact

DT = 0.001
STIFFEST = 2e4


def pressed(stiffness, noise=0.0, depth=1e-3, seed=0):
    """Return a contact that heard of a tip which pressed a wall from 1 N on."""
    rng, seen = np.random.default_rng(seed), Contact.new()
    for place in np.linspace(0.0, depth, 400):
        tip = place + rng.normal(0.0, noise / 6000.0)
        contact.update_contact_model(
            seen, tip, 1.0 + stiffness * place + rng.normal(0.0, noise), STIFFEST
        )
    return seen


@pytest.mark.parametrize("stiffness", [0.0, 300.0, 3000.0, 10000.0])
def test_the_slope_is_found_in_noise(stiffness):
    found = pressed(stiffness, noise=0.02).stiffness
    assert found == pytest.approx(stiffness, rel=0.1, abs=60.0)


def test_a_stop_changes_nothing_however_long_and_noisy():
    seen, rng = pressed(3000.0), np.random.default_rng(1)
    before = seen.stiffness
    for _ in range(10000):
        contact.update_contact_model(
            seen, 1e-3 + rng.normal(0.0, 3e-6), 4.0 + rng.normal(0.0, 0.02), STIFFEST
        )
    assert seen.stiffness == pytest.approx(before, rel=0.05)


def test_the_force_is_that_of_the_hands_place():
    """A hand 0.2 mm deeper than the tip that was heard of, and going deeper."""
    seen = pressed(3000.0)
    contact.predict_force(seen, 4.0, 1e-3, 0.02, STIFFEST, DT)
    force = contact.predict_force(seen, 4.0, 1.2e-3, 0.02, STIFFEST, DT)
    assert force == pytest.approx(4.0 + 3000.0 * 0.2e-3, rel=0.02)


NUMBER = st.floats(allow_nan=True, allow_infinity=True)
SMALL = st.floats(-0.01, 0.01)


@given(
    st.lists(st.tuples(SMALL, st.floats(-30.0, 30.0)), min_size=1, max_size=30),
    st.lists(st.tuples(st.floats(-30.0, 30.0), SMALL, st.floats(-1.0, 1.0)), max_size=10),
)
def test_whatever_was_heard_it_resists_the_hand_and_never_turns_the_force_round(tips, hands):
    seen = Contact.new()
    for travel, force in tips:
        contact.update_contact_model(seen, travel, force, STIFFEST)
    assert 0.0 <= seen.stiffness <= STIFFEST
    for force, place, velocity in hands:
        added = contact.predict_force(seen, force, place, velocity, STIFFEST, DT) - force
        assert added * velocity >= 0.0  # a force against pulling is positive, as the motion is
        assert (force + added) * force >= 0.0


@given(NUMBER, NUMBER)
def test_what_is_no_number_is_not_learnt(travel, force):
    seen = pressed(3000.0)
    contact.update_contact_model(seen, travel, force, STIFFEST)
    assert np.isfinite(seen.tolist()).all()
