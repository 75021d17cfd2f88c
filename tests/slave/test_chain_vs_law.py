"""The chain against the estimator's law: two derivations of one friction that share no equation."""

from itertools import pairwise

import numpy as np
import pytest

from estimator import transmission
from estimator.sheath import Section, Sheath
from slave.plant.chain import SectionConfig, SheathConfig, build_chain, settle, tensions
from slave.plant.load import TipConfig, build_load

UNIFORM = ((1.5, 0.225),)
THREE = ((0.3, np.inf), (0.8, 0.25), (0.4, 0.1))
REVERSALS = (0.0, 14e-3, 9e-3, 12e-3, 8e-3, 10e-3, 3e-3, 13e-3, 6e-3)  # [m] of the motor
PRETENSION = 1.0


@pytest.mark.parametrize("sections", [UNIFORM, THREE], ids=["uniform", "three sections"])
def test_nested_reversals_against_a_spring_and_a_contact(sections):
    sheath = SheathConfig(tuple(SectionConfig(*section) for section in sections))
    chain = build_chain(sheath, PRETENSION)
    load = build_load(TipConfig(PRETENSION))
    law = Sheath(tuple(Section(*s) for s in sections), sheath.friction, sheath.axial_stiffness)
    tables = transmission.tables(law)
    profile = transmission.pretensioned_profile(tables, PRETENSION)
    rest = transmission.observe(tables, profile).elongation
    state = np.zeros(len(chain.friction) + 2)
    seen = []
    for start, end in pairwise(REVERSALS):
        for motor in np.linspace(start, end, 60)[1:]:
            state = settle(chain, load, state, motor)
            T_in, T_out = tensions(chain, state)[[0, -1]]
            profile = transmission.drive_proximal(tables, profile, T_in)
            expected = transmission.observe(tables, profile)
            elongation = state[0] - state[-1]
            seen.append((T_out, expected.T_out, elongation, expected.elongation - rest, T_in))
    T_out, law_T_out, e, law_e, T_in = np.array(seen).T
    assert np.ptp(T_in) > 10.0
    assert np.abs(T_out - law_T_out).max() < 3e-4 * T_out.max()
    assert np.abs(e - law_e).max() < 3e-4 * e.max()
