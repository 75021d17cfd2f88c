"""Where the motors stand: what the encoders said last, all together, or zero by promise."""

import math

import numpy as np
import pytest

from slave.initial_position import (
    InitialPosition,
    increase_age,
    init_position,
    is_known,
    process_sample,
)
from teleop.messages.messages import MAX_TENDONS

AGE_MAX = 0.1


def fresh(tendons=2, starts_at_zero=False):
    memory = InitialPosition.new()
    init_position(memory, tendons, starts_at_zero)
    return memory


def reading(*values):
    return np.array([*values, *[math.nan] * (MAX_TENDONS - len(values))])


def where(memory, tendons=2, age_max=AGE_MAX):
    return memory.position[:tendons].tolist() if is_known(memory, age_max) else []


def test_a_rig_that_starts_at_zero_stands_there_however_long_it_is_silent():
    memory = fresh(starts_at_zero=True)
    for _ in range(1000):
        increase_age(memory, 1.0)
    assert where(memory) == [0.0, 0.0]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("which", [0, 1])
def test_a_reading_that_lacks_an_encoder_counts_for_none_and_the_last_one_grows_older(bad, which):
    memory = fresh()
    process_sample(memory, 2, reading(0.01, 0.02), True)
    increase_age(memory, 0.06)
    partial = reading(0.5, 0.5)
    partial[which] = bad
    process_sample(memory, 2, partial, True)
    assert where(memory) == [0.01, 0.02]
    increase_age(memory, 0.06)
    assert where(memory) == []
