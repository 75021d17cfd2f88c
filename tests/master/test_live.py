"""Settings changed while the master runs: only those, only valid ones, and without a bump."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from master import live_settings
from master.config import MasterConfig
from master.device import HandState
from master.feedback import FeedbackConfig
from master.live_settings import KEYS, SLEW_S
from master.operator import OperatorConfig
from master.settings_record import SettingsRecord, build_master_settings
from teleop.coupling import Bilateral
from teleop.errors import UsageError

DT = 1e-3
SCALES = st.floats(0.0, 10.0)
CHANGES = list(zip(KEYS, ("0.3", "[0, 2]", "0.1"), strict=True))


@settings(max_examples=15, deadline=None)
@given(SCALES, st.lists(st.tuples(SCALES, st.integers(0, 800)), min_size=1, max_size=5))
def test_a_force_scale_goes_where_it_is_sent_without_a_step(first, script):
    state = live_settings.init_settings(MasterConfig(force=FeedbackConfig(scale=first)))
    for scale, ticks in script:
        state, _ = live_settings.change_setting(state, "force.scale", repr(scale))
        gap = abs(scale - state.config.force.scale)
        for _ in range(ticks):
            before = state.config.force.scale
            state = live_settings.advance_ramp(state, DT)
            assert abs(state.config.force.scale - before) <= gap * DT / SLEW_S + 1e-12
        if ticks > SLEW_S / DT:
            assert state.config.force.scale == scale
            assert state.settled


@pytest.mark.parametrize(("key", "value"), CHANGES)
def test_each_key_that_may_be_changed_can_be_and_the_record_follows_every_change(key, value):
    start = MasterConfig(operator=OperatorConfig(workspace=((-0.1, 0.2),)))
    state = live_settings.init_settings(start)
    record = SettingsRecord(state.config, Bilateral())
    state, words = live_settings.change_setting(state, f"master.{key}", value)
    assert words == f"{key} = {value}"
    assert live_settings.change_setting(state, key, value)[0] == state
    for _ in range(round(0.11 * SLEW_S / DT)):
        state = live_settings.advance_ramp(state, 10.0 * DT)
        assert record.update(state.config) == build_master_settings(state.config, Bilateral())
    assert record.update(state.config) != build_master_settings(start, Bilateral())


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("force.scal", "1", "is unknown; did you mean 'force.scale'?"),
        ("force.limit", "1", "cannot be changed while the master runs"),
        ("force", "{}", "cannot be changed"),
        ("force.scale", "nan", "must be 0 to 10"),
        ("force.scale", "!!bool x", "expected a number"),
        ("operator.position_scale", "[" * 200, "expected a number"),
        ("operator.lock", "[9]", "must be 0 to 7"),
    ],
)
def test_what_may_not_be_is_refused_in_one_line(key, value, words):
    state = live_settings.init_settings(MasterConfig())
    with pytest.raises(UsageError, match=words) as refused:
        live_settings.change_setting(state, key, value)
    assert len(str(refused.value).splitlines()) == 1
    assert not str(refused.value).startswith("--set")


ODD = ["!!bool x", "!!int ''", "!!timestamp 'x'", "[" * 100, "1e999", "١", "[٣]"]


@given(st.text(max_size=20) | st.sampled_from(ODD), st.sampled_from(KEYS))
def test_any_text_at_all_is_a_value_or_a_usage_error(value, key):
    try:
        after, _ = live_settings.change_setting(
            live_settings.init_settings(MasterConfig()), key, value
        )
    except UsageError:
        return
    assert math.isfinite(after.force_scale)


def buttons(*held: str) -> HandState:
    return HandState((0.0,), (0.0,), True, **dict.fromkeys(held, True))


@pytest.mark.parametrize(
    ("key", "less", "more", "first"),
    [
        ("operator.position_scale", "finer", "coarser", "0.176777"),
        ("force.scale", "weaker", "stronger", "0.141421"),
    ],
)
def test_a_press_of_a_button_changes_its_scale_once_and_within_bounds(key, less, more, first):
    state, words = live_settings.apply_buttons(
        live_settings.init_settings(MasterConfig()), buttons(less)
    )
    assert words == f"{key} = {first}"
    for _ in range(100):
        state, words = live_settings.apply_buttons(state, buttons(less))
        assert words == ""
    for button, end in ((less, 0.01), (more, 1.0)):
        for _ in range(40):
            state, _ = live_settings.apply_buttons(state, buttons())
            state, words = live_settings.apply_buttons(state, buttons(button))
        assert words == f"{key} = {end:g}"
    state, _ = live_settings.apply_buttons(state, buttons())
    assert live_settings.apply_buttons(state, buttons(less, more))[1] == ""
    assert live_settings.apply_buttons(state, None)[1] == ""


def test_a_press_of_a_button_of_each_scale_at_once_changes_both_and_no_force_jumps():
    before = MasterConfig()
    state, words = live_settings.apply_buttons(
        live_settings.init_settings(before), buttons("coarser", "weaker")
    )
    assert words == "operator.position_scale = 0.353553, force.scale = 0.141421"
    soon = live_settings.advance_ramp(state, 1e-3).config.force.scale
    assert 0.99 * before.force.scale < soon < before.force.scale
    away, _ = live_settings.apply_buttons(state, None)
    assert (
        live_settings.apply_buttons(away, buttons("coarser", "weaker"))[1] == ""
    )  # the same press, still
