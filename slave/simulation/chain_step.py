"""One step of an elastic tendon in its sheath, a chain of springs and friction nodes.

Quasi-static: every node is in balance at the end of a step. With u the displacement of the tendon
(positive towards the housing), T_i the tension of the spring behind node i, and the laws of springs
and nodes linearised over a step (`elasticity`, `friction`),

    u_i - u_{i+1} = compliance_i T_i + rest_i      where T_i > 0; less stretched, T_i = 0
    T_{i-1} - T_i = f_i + b_i du_i / dt            dry friction and a dashpot
    f_i at its upper limit where the node slides towards the housing, at its lower one where it
    slides towards the tip, anything between where it stays, or as its bristle says

The tension profile along the sheath is not assumed, in contrast to an estimator.

The balance is solved exactly and without iteration. For a given motor position, the housing side of
any point responds with a tension that is piecewise linear in the point's position and falls towards
the housing. `compute_response` propagates that response from the motor to the tip, by
`transfer_coulomb_contact`, or `transfer_bristle_contact` for bristles and dashpots. The caller
finds the tip position from that curve, and `recover_state` computes the nodes backwards from there.
"""

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from slave.simulation.friction_nodes import (
    Response,
    init_bristle_contact,
    init_coulomb_contact,
    transfer_bristle_contact,
    transfer_coulomb_contact,
)
from slave.simulation.tendon import (
    CONTACT_GROWTH,
    CREEP,
    POSITION,
    SPEED,
    TENSION,
    Chain,
    advance_contact_growth,
    advance_creep,
    compute_contacts,
    compute_creep_gain,
    compute_springs,
    filter_speed,
)


@jit_compile
def compute_response(chain: Chain, state: Array, proximal: float, dt: float) -> Response:
    """Return the tension response of the tendon at its tip in a step of `dt` [s].

    `state`, shape (6, n + 2), is before the step, `proximal` [m] the motor end's place after it.
    """
    spring, contact = compute_springs(chain, state, dt), compute_contacts(chain, state, dt)
    if len(contact.bristle) > 0:
        return transfer_bristle_contact(spring, contact, state, proximal)
    return transfer_coulomb_contact(spring, contact, state, proximal)


@jit_compile
def recover_state(
    chain: Chain,
    state: Array,
    response: Response,
    proximal: float,
    distal: float,
    tension: float,
    dt: float,
) -> Array:
    """Return the state after a step that ends with the tip at `distal` [m].

    `tension` [N] is that of `response` there; `response` is from `compute_response` with the same
    arguments.
    """
    n = len(chain.friction)
    recovered = np.zeros_like(state)
    recovered[POSITION, 0], recovered[POSITION, n + 1] = proximal, distal
    recovered[TENSION, n] = tension
    if len(response.contacts.bristle) > 0:
        init_bristle_contact(response, state, recovered)
    else:
        init_coulomb_contact(response, state, recovered)
    stretch = proximal - recovered[POSITION, 1] - response.springs.rest[0]
    recovered[TENSION, 0] = max(0.0, stretch / response.springs.compliance[0])
    gain = compute_creep_gain(chain.deviations, dt)
    for i in range(n + 1):
        recovered[CREEP, i] = advance_creep(chain, state[CREEP, i], recovered[TENSION, i], gain)
    for i in range(1, n + 1):
        speed = (recovered[POSITION, i] - state[POSITION, i]) / dt
        recovered[SPEED, i] = filter_speed(chain.deviations, state[SPEED, i], speed, dt)
        recovered[CONTACT_GROWTH, i] = advance_contact_growth(
            chain.deviations, state[CONTACT_GROWTH, i], speed, dt
        )
    return recovered
