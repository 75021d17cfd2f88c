"""The chain against the estimator's law: two derivations of one friction that share no equation."""

from itertools import pairwise

import numpy as np
import pytest

from estimator.law import transmission
from estimator.law.sheath import Section, Sheath
from slave.sheath_section import SectionConfig
from slave.simulation.tendon import SheathConfig, build_chain
from tests.slave.tendon_bench import Load, drive, ends, travels

UNIFORM = ((1.5, 0.225),)
THREE = ((0.3, np.inf), (0.8, 0.25), (0.4, 0.1))
REVERSALS = (0.0, 14e-3, 9e-3, 12e-3, 8e-3, 10e-3, 3e-3, 13e-3, 6e-3)  # [m] of the motor
PRETENSION = 1.0


@pytest.mark.parametrize("sections", [UNIFORM, THREE], ids=["uniform", "three sections"])
def test_nested_reversals_against_a_spring(sections):
    sheath = SheathConfig(tuple(SectionConfig(*section) for section in sections))
    chain = build_chain(sheath, PRETENSION)
    law = Sheath(tuple(Section(*s) for s in sections), sheath.friction, sheath.axial_stiffness)
    tables = transmission.build_tables(law)
    profile = transmission.build_pretensioned_profile(tables, PRETENSION)
    rest = transmission.observe(tables, profile).elongation
    turns = pairwise(REVERSALS)
    path = np.concatenate([np.linspace(start, end, 60)[1:] for start, end in turns])
    states = drive(chain, Load(PRETENSION, 600.0), path)[1:]
    (T_in, T_out), (motor, tip) = ends(states), travels(states)
    law_T_out, law_e = np.empty((2, len(T_in)))
    for i, tension in enumerate(T_in):
        profile = transmission.drive_proximal(tables, profile, tension)
        expected = transmission.observe(tables, profile)
        law_T_out[i], law_e[i] = expected.T_out, expected.elongation - rest
    e = motor - tip
    assert np.ptp(T_in) > 10.0
    assert np.abs(T_out - law_T_out).max() < 3e-4 * T_out.max()
    assert np.abs(e - law_e).max() < 3e-4 * e.max()
