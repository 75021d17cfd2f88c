"""What two motors have wound in, by itself: broken and jammed tendons, and what is neither."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.law.sheath import Sheath
from estimator.structs import to_struct, view_struct
from slave.fault_detection import FaultDetectionConfig
from slave.fault_detection.wound_length import (
    CheckedTendon,
    SlackState,
    WindingCheck,
    check_slack,
    check_winding,
    compute_compliance,
    compute_elongation_max,
    compute_elongation_min,
)
from slave.rig_layout import build_rig_layout
from studies.testbed.control_bench import DT
from teleop.session.state_machine import Reason

CONFIG = to_struct(FaultDetectionConfig())
BROKEN, JAMMED = Reason.TENDON_BROKEN, Reason.TENDON_JAMMED
HEALTHY = Reason.NONE, -1
SHEATH = Sheath.uniform(1.0, 1.5, 9000.0)
STRETCH = compute_compliance(SHEATH)


def least(tension):
    return compute_elongation_min(STRETCH, tension)


def most(tension):
    return compute_elongation_max(STRETCH, tension)


PAIR = view_struct(build_rig_layout(((0, 1),))).group[0]


def tendons_of_a_pair():
    """Return their records and a view of each."""
    pair = CheckedTendon.array(2)
    a, b = view_struct(pair, 0), view_struct(pair, 1)
    a.compliance = b.compliance = STRETCH
    return pair, (a, b)


def set_average(tendon, tension, displacement, speed=0.0):
    average = tendon.average
    average.tension, average.displacement, average.speed = tension, displacement, speed


def wound(path, dt=DT):
    """Return what is found on a path of (T_a, T_b, q_a, q_b): (reason, which of the two)."""
    winding, (pair, each), found, before = WindingCheck.new(), tendons_of_a_pair(), [], (0.0, 0.0)
    for *tension, q_a, q_b in path:
        for one, T, was, q in zip(each, tension, before, (q_a, q_b), strict=True):
            set_average(one, T, q)
            check_slack(CONFIG, one.slack, T, was, q_a + q_b, dt)
        before = tension
        found.append(check_winding(CONFIG, winding, pair, PAIR, dt))
    return found


def test_a_tendon_is_stretched_least_by_a_pull_and_most_by_a_release():
    """M_pull = L (1 - e^-K)/(EA K) and M_rel = M_pull e^K of an even bend, paper (12), (23)."""
    pull = 1.5 * (1.0 - math.exp(-1.0)) / 9000.0
    assert least(2.0) == pytest.approx(2.0 * pull)
    assert most(2.0) == pytest.approx(2.0 * pull * math.e)
    drag = Sheath.uniform(1.0, 1.5, 9000.0, drag=0.5)
    assert compute_elongation_min(compute_compliance(drag), 2.0) == pytest.approx(
        2.5 * pull - 0.5 * 1.5 / 9000.0
    )


shares = st.floats(0.0, 1.0)
tensions = st.floats(0.0, 25.0)


@given(
    st.lists(st.tuples(tensions, tensions, shares, shares, st.floats(-0.02, 0.02)), max_size=60),
    st.floats(-0.01, 0.01),
    st.floats(0.97, 1.03),
)
def test_tendons_stretched_within_what_friction_allows_are_healthy(samples, constant, error):
    """Whatever the history, whoever drove: every sample may be anywhere in its interval."""
    path = []
    for T_a, T_b, share_a, share_b, travel in samples:
        e = [
            error * (least(T) + share * (most(T) - least(T)))
            for T, share in ((T_a, share_a), (T_b, share_b))
        ]
        path += [(T_a, T_b, travel + e[0] + constant, e[1] - travel)] * 12
    found = wound(path)
    assert set(found) <= {HEALTHY}


def test_where_both_are_slack_the_first_or_tighter_of_them_is_broken():
    drove = healthy(0.3, 5.0)[2:]
    before = [(0.3, 5.0, *drove)] * 20
    found = wound(before + [(0.0, 0.0, *drove)] * 20)
    assert found[-1] == (BROKEN, 1)
    found = wound(before + [(0.0, 5.0, *drove)] + [(0.0, 0.0, *drove)] * 20)
    assert found[-1] == (BROKEN, 0)


def test_a_taut_tendon_goes_slack_from_where_it_is():
    """Also one that was slack before, and was wound in until it was taut again."""
    again = SlackState.new(time=0.3, lost=1.0, wound=0.004)
    check_slack(CONFIG, again, 2.0, 0.0, 0.008, DT)
    for taut in (SlackState.new(), again):
        broken = check_slack(CONFIG, taut, 0.0, 5.0, 0.012, DT)
        assert (broken, taut.time, taut.lost, taut.wound) == (False, 0.0, 5.0, 0.012)


def healthy(T_a, T_b, travel=0.0):
    return T_a, T_b, travel + least(T_a), least(T_b) - travel


def test_a_slack_tendon_that_is_wound_in_is_broken_within_the_millimetre():
    path = [healthy(5.0, 0.3)] * 20
    T_a, T_b, q_a, q_b = healthy(0.0, 0.3)
    path += [(T_a, T_b, q_a + k * 5e-6, q_b) for k in range(200)]  # reeled in at 5 mm/s
    found = wound(path)
    first = next(k for k, finding in enumerate(found) if finding != HEALTHY)
    assert found[first] == (BROKEN, 0)
    assert (first - 20) * 5e-6 < 1e-3
    # an antagonist that is stretched unseen explains as much as friction can hide, not more
    hidden = [healthy(5.0, 0.3)] * 20 + [(0.0, 0.3, q_a, q_b + most(0.3))] * 50
    assert wound(hidden)[-1] == HEALTHY


def test_a_tension_that_gone_without_the_motor_is_a_broken_tendon():
    T_a, T_b, q_a, q_b = healthy(10.0, 0.3)
    found = wound([(T_a, T_b, q_a, q_b)] * 20 + [(0.0, T_b, q_a, q_b)] * 15)
    assert found[-1] == (BROKEN, 0)
    assert found[25] == HEALTHY  # not by a single sample


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_a_tendon_stretched_over_a_part_of_its_sheath_is_jammed(share):
    part = Sheath.uniform(share * 1.0, share * 1.5, 9000.0)
    jammed = compute_compliance(part)
    path = [healthy(0.3, 0.3)] * 20
    path += [(0.3, T, 0.0, compute_elongation_min(jammed, T)) for T in np.linspace(0.3, 20.0, 300)]
    found = wound(path)
    assert found[-1] == (JAMMED, 1)


def test_what_drifts_slowly_is_creep():
    T_a, T_b, q_a, q_b = healthy(0.3, 0.3)
    dt = 0.01  # [s] a minute is long
    for drift in (-1e-5, 1e-5):  # [m/s] 0.6 mm in a minute
        path = [(T_a, T_b, q_a, q_b + drift * dt * k) for k in range(6000)]
        found = wound(path, dt)
        assert found[-1] == HEALTHY


def test_a_tendon_paid_out_until_it_is_slack_is_not_jammed():
    T_a, T_b, q_a, q_b = healthy(0.3, 0.3)
    path = [(T_a, T_b, q_a, q_b)] * 20
    path += [(T_a, 0.0, q_a, q_b - k * 5e-5) for k in range(100)]
    found = wound(path)
    assert set(found) <= {HEALTHY}


def test_pulleys_that_are_not_quite_alike_are_no_fault():
    path = [healthy(0.3, 0.3)] * 20
    for travel in np.linspace(0.0, 0.015, 300):
        T_a, T_b, q_a, q_b = healthy(2.0, 0.3)
        path.append((T_a, T_b, q_a + travel, q_b - 1.03 * travel))
    found = wound(path)
    assert set(found) <= {HEALTHY}


def test_a_load_cell_that_lags_is_no_fault_however_fast_the_motor():
    """Paid out at 50 mm/s with tensions 10 ms old: they are too high for 0.5 mm less of stretch."""
    speed, late = 0.05, 10
    stretch = np.maximum(least(20.0) - speed * DT * np.arange(41), least(0.3))
    tension = stretch / STRETCH.pull
    winding, (pair, (late_one, other)) = WindingCheck.new(), tendons_of_a_pair()
    for k in range(-20, 41):
        now, then = max(k, 0), max(k - late, 0)
        set_average(late_one, tension[then], stretch[now], -speed if k > 0 else 0.0)
        set_average(other, 0.3, least(0.3))
        if k == -20:  # it began loose
            loose, each = tendons_of_a_pair()
            for one in each:
                set_average(one, 0.3, least(0.3))
            check_winding(CONFIG, winding, loose, PAIR, DT)
        assert check_winding(CONFIG, winding, pair, PAIR, DT) == HEALTHY
