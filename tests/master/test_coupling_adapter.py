"""The coupling at the master: hand units outside, tip units inside."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.structs import view_struct
from master import coupling_adapter
from master.coupling_adapter import RenderMemory
from master.device import HandState
from teleop.coupling import Bilateral, PassivityConfig, Side, to_bilateral_settings
from tests.master.records import eight, hand_record

DT = 1e-3
PASSIVITY = Bilateral(coupling=PassivityConfig(hand_damping=0.0))


def at(place, speed=0.0):
    return HandState((place / 0.25,), (speed / 0.25,), True)


class Axis:
    """One axis at the master, tick by tick; places and travels in units of the tip."""

    def __init__(self, bilateral):
        self.settings, self.side = view_struct(to_bilateral_settings(bilateral)), Side.new()
        self.rendered = RenderMemory.new()

    def step(self, place, scale, written, wanted, coupled=True, hand=None):
        counted = coupled and math.isfinite(wanted)
        coupling_adapter.add_hand_work(
            self.settings, self.side, self.rendered, hand_record(hand or at(place)), scale, 0.25,
            eight(written), 1, counted, DT,
        )  # fmt: skip
        out = eight()
        coupling_adapter.render_force(
            self.settings, self.side, scale, eight(wanted), 1, counted, out
        )
        if coupled:
            coupling_adapter.store_rendered_force(self.rendered, scale, out, 1)
        assert not out[1:].any()
        return out[0]

    @property
    def joint(self):
        return self.side.ports[0]


@given(st.floats(0.05, 1.0))
def test_energy_is_counted_in_units_of_the_tip(scale):
    """2 N at the tip over 20 um, whatever the hand feels of it."""
    axis = Axis(PASSIVITY)
    force = axis.step(0.0, scale, 0.0, -2.0 * scale)
    axis.step(2e-5, scale, force, -2.0 * scale)
    assert axis.joint.put_in == pytest.approx(2.0 * 2e-5)


def test_uncoupled_or_not_finite_goes_on_to_the_gate_as_it_is():
    axis = Axis(PASSIVITY)
    force = axis.step(0.0, 0.2, 0.0, float("nan"))
    assert force != force
    assert not axis.side.coupled
    assert Axis(PASSIVITY).step(0.0, 0.2, 0.0, -1.0, coupled=False) == -1.0


@given(st.lists(st.sampled_from([0.0, 1e-17, 1e-9, 0.01, 0.2, 5.0]), min_size=2, max_size=20))
def test_however_the_force_s_scale_changes_no_work_is_made_up(scales):
    """10 N at the tip over 0.1 mm a tick is the most that any scale can make of it."""
    axis, written = Axis(PASSIVITY), 0.0
    for k, scale in enumerate(scales):
        before = axis.joint.put_in
        written = axis.step(1e-4 * k, scale, written, -10.0 * scale)
        assert axis.joint.put_in - before <= 10.0 * 1e-4 * (1.0 + 1e-9)


def test_a_hand_that_the_tip_does_not_follow_takes_out_no_more_than_it_put_in():
    """A locked axis under load: the hand gives way, and work is that of its own motion."""
    axis, written, out = Axis(PASSIVITY), 0.0, 0.0
    for k in range(2000):
        out += -written / 0.2 * 1e-5 if k else 0.0
        written = axis.step(-1e-5 * k, 0.2, written, -10.0 * 0.2)
    assert 0.5 * PASSIVITY.coupling.reserve < out <= PASSIVITY.coupling.reserve + 1e-9
    assert axis.joint.taken_out == pytest.approx(out, rel=0.02)


@given(st.floats(-5.0, 5.0), st.floats(0.0, 3.0))
def test_a_force_that_the_coupling_did_not_ask_for_is_no_work_of_it(written, wanted):
    axis = Axis(Bilateral())
    axis.step(0.0, 0.2, 0.0, -wanted)
    axis.step(1e-3, 0.2, written, -wanted)
    assert axis.joint.put_in <= wanted / 0.2 * 1e-3 + 1e-12
    assert axis.joint.taken_out == 0.0


def test_the_damping_of_a_hand_counts_on_the_device():
    """2 N s/m at 0.1 m/s for 1 s is 20 mJ on the device; 0.25 / 0.2 of it in a tip's units."""
    rule = PassivityConfig(hand_damping=2.0, credit_max=1.0)
    axis = Axis(Bilateral(coupling=rule))
    for k in range(1001):
        axis.step(0.0, 0.2, 0.0, 0.0, hand=HandState((1e-4 * k,), (0.1,), True))
    assert axis.joint.granted == pytest.approx(0.020 * 0.25 / 0.2 + rule.reserve, rel=0.01)
